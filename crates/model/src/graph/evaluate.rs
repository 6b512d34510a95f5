//! Residuals, Jacobians and moved values of what stands in a graph.

use smallvec::SmallVec;

use super::{Graph, Partial, Term};
use crate::arguments::{Arguments, Linearization};
use crate::error::GraphError;
use crate::factor::Factor;
use crate::key::{FactorIndex, VariableIndex};
use crate::user_code::{guarded_factor, guarded_variable};

/// # Evaluation at numbers in dense arrays, for solvers
///
/// Embedding programs ask a smoother instead: `Smoother::error_of_factor`, `Smoother::residual_of` and
/// `Smoother::linearization_of` take ids and use its estimate.
///
/// These methods panic on slots that hold nothing and on arrays that are too short.
impl Graph {
    /// Linearizes the factor in a slot at `values` (laid out by [`value_range`](Self::value_range))
    /// into `out`, `[J₁ … Jₖ | r]` column-major, a block for each of its
    /// [unknowns](Self::unknowns_at).
    ///
    /// # Errors
    /// [`GraphError::FactorPanicked`]; `out` then holds no meaningful numbers.
    pub fn linearize(
        &self,
        factor: FactorIndex,
        values: &[f64],
        out: &mut [f64],
    ) -> Result<(), GraphError> {
        let term = self.term(factor);
        match &term.partial {
            None => self.linearize_all(factor, term, values, out),
            Some(partial) => {
                let columns = term.columns[term.columns.len() - 1] as usize + 1;
                let mut whole: SmallVec<[f64; 96]> =
                    SmallVec::from_elem(0.0, term.rows as usize * columns);
                self.linearize_all(factor, term, values, &mut whole)?;
                copy_unknowns(term, partial, &whole, out);
                Ok(())
            }
        }
    }

    /// Blocks for all variables of a factor.
    fn linearize_all(
        &self,
        factor: FactorIndex,
        term: &Term,
        values: &[f64],
        out: &mut [f64],
    ) -> Result<(), GraphError> {
        out.fill(0.0);
        self.evaluate(factor, values, |factor, arguments| {
            let mut linearization = Linearization::new(term.rows as usize, &term.columns, out);
            factor.linearize(arguments, &mut linearization);
        })
    }

    /// The whitened residual of the factor in a slot at `values`; `out` has
    /// [`rows_at`](Self::rows_at) entries.
    ///
    /// # Errors
    /// [`GraphError::FactorPanicked`]; `out` then holds no meaningful numbers.
    pub fn residual(
        &self,
        factor: FactorIndex,
        values: &[f64],
        out: &mut [f64],
    ) -> Result<(), GraphError> {
        self.evaluate(factor, values, |factor, arguments| factor.residual(arguments, out))
    }

    /// The term of the objective of the factor in a slot at `values`.
    ///
    /// # Errors
    /// [`GraphError::FactorPanicked`].
    pub fn factor_error(&self, factor: FactorIndex, values: &[f64]) -> Result<f64, GraphError> {
        with_scratch(self.rows_at(factor), 0.0, |residual: &mut [f64]| {
            self.evaluate(factor, values, |factor, arguments| {
                factor.residual(arguments, residual);
                factor.error(residual)
            })
        })
    }

    /// The objective at `values`: the sum of all factors' terms, in the order of their slots.
    ///
    /// # Errors
    /// [`GraphError::FactorPanicked`].
    pub fn error(&self, values: &[f64]) -> Result<f64, GraphError> {
        self.factor_indices().map(|f| self.factor_error(f, values)).sum()
    }

    /// The value of the variable in a slot, moved from `point` along `delta`, a tangent vector
    /// there. `out` has the length of the variable's [`value_range`](Self::value_range).
    ///
    /// # Errors
    /// [`GraphError::VariablePanicked`], [`GraphError::NonFiniteRetraction`]; `out` then holds no
    /// meaningful numbers.
    pub fn retract(
        &self,
        variable: VariableIndex,
        point: &[f64],
        delta: &[f64],
        out: &mut [f64],
    ) -> Result<(), GraphError> {
        let (id, kind) = (self.variable_id(variable), self.kind_at(variable));
        guarded_variable(id, kind, || kind.retract(point, delta, out))?;
        if out.iter().all(|x| x.is_finite()) {
            Ok(())
        } else {
            Err(GraphError::NonFiniteRetraction { variable: id, kind: kind.name() })
        }
    }

    /// Calls the factor in a slot with its arguments out of `values`.
    fn evaluate<R>(
        &self,
        index: FactorIndex,
        values: &[f64],
        call: impl FnOnce(&dyn Factor, &Arguments<'_>) -> R,
    ) -> Result<R, GraphError> {
        let term = self.term(index);
        with_scratch(term.variables.len(), &values[..0], |storages| {
            for (storage, &variable) in storages.iter_mut().zip(&term.variables) {
                *storage = &values[self.value_range(variable)];
            }
            guarded_factor(self.factor_id(index), &*term.factor, || {
                call(&*term.factor, &Arguments::new(storages))
            })
        })
    }
}

/// Copies the blocks of a factor's unknowns, and its residual, from those of all its variables.
fn copy_unknowns(term: &Term, partial: &Partial, whole: &[f64], out: &mut [f64]) {
    let rows = term.rows as usize;
    let mut unknowns = partial.unknowns.iter().peekable();
    let mut end = 0;
    for (k, variable) in term.variables.iter().enumerate() {
        if unknowns.next_if_eq(&variable).is_some() {
            let block =
                &whole[rows * term.columns[k] as usize..rows * term.columns[k + 1] as usize];
            out[end..end + block.len()].copy_from_slice(block);
            end += block.len();
        }
    }
    out[end..].copy_from_slice(&whole[whole.len() - rows..]);
}

/// A slice of `len` for the time of `f`: on the stack, unless a factor is unusually large.
fn with_scratch<T: Copy, R>(len: usize, fill: T, f: impl FnOnce(&mut [T]) -> R) -> R {
    match [fill; 6].get_mut(..len) {
        Some(scratch) => f(scratch),
        None => f(&mut vec![fill; len]),
    }
}
