//! Factors with the values of some of their variables put in.

use std::any::Any;
use std::sync::Arc;

use evergraph_model::{Arguments, Factor, Linearization, Value, VariableId, VariableType};
use smallvec::SmallVec;

/// A factor of which some variables are given, so that it is a factor on the others.
///
/// ```text
/// r(x₁, x₂, …) = r_whole(x₁, v₂, …)
/// ```
///
/// Residual, noise and kernel are those of the whole factor. The values are copies: they do not follow the variables that
/// they are taken from.
#[derive(Clone, Debug)]
pub struct Conditioned {
    whole: Arc<dyn Factor>,
    keys: SmallVec<[VariableId; 4]>,
    /// For each variable of the whole factor, in the order of its keys.
    arguments: SmallVec<[Argument; 4]>,
}

/// The input of a [`Conditioned`] factor in the place of a variable of the whole factor.
#[derive(Clone, Debug)]
pub enum Input {
    /// A variable: the same or another one of the same type.
    Variable(VariableId),
    /// A value.
    Value(Value),
}

#[derive(Clone, Debug)]
enum Argument {
    /// The place among the keys.
    Free(usize),
    Given(Value),
}

impl Conditioned {
    /// The factor `whole` with the values of `given`. `None` when it has no variable left, or does not take a value.
    /// Entries of `given` that are no variables of the factor are ignored.
    pub fn new(whole: Arc<dyn Factor>, given: &[(VariableId, Value)]) -> Option<Self> {
        let input = |key: &VariableId| match given.iter().find(|(id, _)| id == key) {
            Some((_, value)) => Input::Value(value.clone()),
            None => Input::Variable(*key),
        };
        let inputs: SmallVec<[Input; 4]> = whole.keys().iter().map(input).collect();
        Self::with_inputs(whole, inputs)
    }

    /// The factor `whole` with an input for each of its variables, in the order of its keys. `None` when the count is
    /// another, when no input is a variable, or when the factor does not take a value.
    pub fn with_inputs(
        whole: Arc<dyn Factor>,
        inputs: impl IntoIterator<Item = Input>,
    ) -> Option<Self> {
        let (mut keys, mut arguments) = (SmallVec::new(), SmallVec::new());
        for (position, input) in inputs.into_iter().enumerate() {
            arguments.push(match input {
                Input::Variable(variable) => {
                    keys.push(variable);
                    Argument::Free(keys.len() - 1)
                }
                Input::Value(value) if !whole.accepts(position, value.kind(), value.dim()) => {
                    return None;
                }
                Input::Value(value) => Argument::Given(value),
            });
        }
        let fits = !keys.is_empty() && arguments.len() == whole.keys().len();
        fits.then_some(Self { whole, keys, arguments })
    }

    /// The whole factor.
    pub fn whole(&self) -> &Arc<dyn Factor> {
        &self.whole
    }

    /// The given values, with the places of their variables among the keys of the [whole](Self::whole) factor.
    pub fn given(&self) -> impl Iterator<Item = (usize, &Value)> {
        self.arguments.iter().enumerate().filter_map(|(position, argument)| match argument {
            Argument::Given(value) => Some((position, value)),
            Argument::Free(_) => None,
        })
    }

    /// The arguments of the whole factor.
    fn storages<'a>(&'a self, at: &Arguments<'a>) -> SmallVec<[&'a [f64]; 4]> {
        let storage = |argument: &'a Argument| match argument {
            Argument::Free(place) => at.storage(*place),
            Argument::Given(value) => value.storage(),
        };
        self.arguments.iter().map(storage).collect()
    }
}

impl Factor for Conditioned {
    fn name(&self) -> String {
        format!("Conditioned<{}>", self.whole.name())
    }

    fn keys(&self) -> &[VariableId] {
        &self.keys
    }

    fn residual_dim(&self) -> usize {
        self.whole.residual_dim()
    }

    fn accepts(&self, position: usize, kind: &VariableType, dim: usize) -> bool {
        let is_it =
            |argument: &Argument| matches!(argument, Argument::Free(place) if *place == position);
        let whole = self.arguments.iter().position(is_it);
        whole.is_some_and(|whole| self.whole.accepts(whole, kind, dim))
    }

    fn residual(&self, at: &Arguments<'_>, out: &mut [f64]) {
        self.whole.residual(&Arguments::new(&self.storages(at)), out);
    }

    fn linearize(&self, at: &Arguments<'_>, out: &mut Linearization<'_>) {
        let rows = out.rows();
        let mut columns: SmallVec<[u32; 5]> = SmallVec::from_slice(&[0]);
        let mut width = 0;
        for argument in &self.arguments {
            width += match argument {
                Argument::Free(place) => out.block_mut(*place).len() / rows.max(1),
                Argument::Given(value) => value.dim(),
            };
            columns.push(width as u32);
        }
        let mut all = vec![0.0; rows * (width + 1)];
        let mut whole = Linearization::new(rows, &columns, &mut all);
        self.whole.linearize(&Arguments::new(&self.storages(at)), &mut whole);
        for (position, argument) in self.arguments.iter().enumerate() {
            if let Argument::Free(place) = argument {
                out.block_mut(*place).copy_from_slice(whole.block_mut(position));
            }
        }
        out.residual_mut().copy_from_slice(whole.residual_mut());
    }

    fn error(&self, residual: &[f64]) -> f64 {
        self.whole.error(residual)
    }

    fn as_any(&self) -> &dyn Any {
        self
    }
}

#[cfg(test)]
mod tests {
    use evergraph_model::testing::assert_jacobian;
    use evergraph_model::{Graph, Noise, Point2, Pose2, linearize_at};

    use super::*;
    use crate::{BetweenPose2, RelativePosition2};

    #[test]
    fn a_conditioned_factor_is_the_whole_one_at_the_given_value() {
        let mut change = Graph::new().change();
        let poses = [Pose2::new(0.3, -0.2, 0.4), Pose2::new(1.4, 0.1, 0.9)];
        let [a, b] = poses.map(|pose| change.add_variable(&pose));
        let [first, second] = poses.map(|pose| Value::new(&pose));
        let noise = Noise::from_sigmas(&[0.1, 0.2, 0.05]).unwrap();
        let z = Pose2::new(1.0, 0.2, 0.3);
        let whole: Arc<dyn Factor> = Arc::new(BetweenPose2::new(a, b, z, noise).unwrap());
        let both = linearize_at(&*whole, &[first.as_ref(), second.as_ref()]).unwrap();
        for (given, free, place) in [(a, &second, 1), (b, &first, 0)] {
            let value = if place == 1 { first.clone() } else { second.clone() };
            let part = Conditioned::new(Arc::clone(&whole), &[(given.id(), value)]).unwrap();
            assert_eq!(part.keys().len(), 1);
            assert_jacobian(&part, std::slice::from_ref(free));
            let own = linearize_at(&part, &[free.as_ref()]).unwrap();
            assert_eq!(own.jacobian(0), both.jacobian(place));
            assert_eq!((own.residual(), own.error()), (both.residual(), both.error()));
            assert_eq!(part.given().map(|(position, _)| position).collect::<Vec<_>>(), [1 - place]);
        }
        let all = [(a.id(), first.clone()), (b.id(), second)];
        assert!(Conditioned::new(Arc::clone(&whole), &all).is_none(), "no variable is left");
        let point = Value::new(&Point2::new(0.0, 0.0));
        assert!(Conditioned::new(whole, &[(a.id(), point.clone())]).is_none(), "a is no point");
        let corner = change.add_variable(&Point2::new(2.0, 1.0));
        let noise = Noise::from_sigmas(&[0.1, 0.1]).unwrap();
        let seen = RelativePosition2::new(a, corner, Point2::new(1.5, 1.0), noise).unwrap();
        let part = Conditioned::new(Arc::new(seen), &[(corner.id(), point)]).unwrap();
        assert_jacobian(&part, &[first]);
    }
}
