//! The linear problems of the chordal initialization: vectors that are linear in each other.

use std::any::Any;

use evergraph_model::{Arguments, Factor, Key, Linearization, VariableId, VariableType, VectorN};
use evergraph_solver::{Relinearization, Settings, Smoother, SmootherError};
use nalgebra::{SMatrix, SVector};

/// `x_to = A x_from + b`, worth `weight` (an information) in every direction.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Relation<const D: usize> {
    pub from: usize,
    pub to: usize,
    pub matrix: SMatrix<f64, D, D>,
    pub offset: SVector<f64, D>,
    pub weight: f64,
}

/// The vectors that meet the relations best in the sense of least squares. Those in `known` stay
/// what they are; some must be known in each part that the relations connect.
pub(crate) fn solve<const D: usize>(
    known: &[Option<SVector<f64, D>>],
    relations: &[Relation<D>],
    settings: &Settings,
) -> Result<Vec<SVector<f64, D>>, SmootherError> {
    let mut smoother = Smoother::new(settings.with_relinearization(Relinearization::NEVER))?;
    let mut change = smoother.change();
    let ends: Vec<End<D>> = known
        .iter()
        .map(|known| match known {
            Some(vector) => End::Known(*vector),
            None => End::Free(change.add_variable(&VectorN::zeros(D))),
        })
        .collect();
    let identity = SMatrix::identity();
    for relation in relations {
        let scale = relation.weight.sqrt();
        let mut equation =
            Equation::<D> { keys: Vec::new(), blocks: Vec::new(), target: relation.offset };
        for (end, block) in [(relation.from, -relation.matrix), (relation.to, identity)] {
            match &ends[end] {
                End::Known(vector) => equation.target -= block * vector,
                End::Free(key) => {
                    equation.keys.push(key.id());
                    equation.blocks.push(scale * block);
                }
            }
        }
        equation.target *= scale;
        if !equation.keys.is_empty() {
            change.add_factor(equation);
        }
    }
    smoother.apply(change)?;
    let estimates = smoother.estimates()?;
    let solved = |end: &End<D>| match end {
        End::Known(vector) => Ok(*vector),
        End::Free(key) => Ok(SVector::from_column_slice(estimates.get(*key)?.as_slice())),
    };
    ends.iter().map(solved).collect()
}

enum End<const D: usize> {
    Known(SVector<f64, D>),
    Free(Key<VectorN>),
}

/// `Σ Aₖ xₖ = target`, whitened.
#[derive(Clone, Debug)]
struct Equation<const D: usize> {
    keys: Vec<VariableId>,
    blocks: Vec<SMatrix<f64, D, D>>,
    target: SVector<f64, D>,
}

impl<const D: usize> Equation<D> {
    fn at(&self, at: &Arguments<'_>) -> SVector<f64, D> {
        let product = |(k, block)| block * SVector::from_column_slice(at.storage(k));
        self.blocks.iter().enumerate().map(product).sum::<SVector<f64, D>>() - self.target
    }
}

impl<const D: usize> Factor for Equation<D> {
    fn name(&self) -> String {
        "Equation".into()
    }

    fn keys(&self) -> &[VariableId] {
        &self.keys
    }

    fn residual_dim(&self) -> usize {
        D
    }

    fn accepts(&self, _position: usize, kind: &VariableType, dim: usize) -> bool {
        kind.is::<VectorN>() && dim == D
    }

    fn residual(&self, at: &Arguments<'_>, out: &mut [f64]) {
        out.copy_from_slice(self.at(at).as_slice());
    }

    fn linearize(&self, at: &Arguments<'_>, out: &mut Linearization<'_>) {
        for (position, block) in self.blocks.iter().enumerate() {
            out.set_block(position, block);
        }
        out.set_residual(&self.at(at));
    }

    fn as_any(&self) -> &dyn Any {
        self
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// x1 = x0 + 1 (weight 1), x1 = x0 + 2 (weight 3), with x0 = 10.
    #[test]
    fn weights_are_information() {
        let relation = |offset, weight| Relation::<1> {
            from: 0,
            to: 1,
            matrix: SMatrix::identity(),
            offset: SVector::<f64, 1>::new(offset),
            weight,
        };
        let known = [Some(SVector::<f64, 1>::new(10.0)), None];
        let relations = [relation(1.0, 1.0), relation(2.0, 3.0)];
        let solved = solve(&known, &relations, &Settings::default()).unwrap();
        assert!((solved[1][0] - 11.75).abs() < 1e-12 && solved[0][0] == 10.0, "{solved:?}");
    }
}
