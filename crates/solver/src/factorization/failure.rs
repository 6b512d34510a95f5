//! Errors in words.

use evergraph_model::{FactorIndex, Staged};

use super::state::Factorization;
use crate::diagnose::{self, Dropped};
use crate::eliminate::Failure;
use crate::error::SmootherError;
use crate::linearization::Flaw;

impl Factorization {
    /// Explains why a factor could not be linearized.
    pub(super) fn flawed(&self, factor: FactorIndex, flaw: Flaw) -> SmootherError {
        match flaw {
            Flaw::NotFinite => SmootherError::NonFinite {
                factor: self.graph.factor_id(factor),
                name: self.graph.factor_at(factor).name(),
                variables: self.graph.factor_at(factor).keys().to_vec(),
            },
            Flaw::Refused(error) => error.into(),
        }
    }

    /// Explains a failure. Factors and variables that a staged change drops do not count.
    pub(super) fn explain(&self, failure: Failure, staged: Option<&Staged>) -> SmootherError {
        match failure {
            Failure::Undetermined { variable } => {
                let dropped = staged.map_or_else(Dropped::default, |staged| Dropped {
                    factors: staged.dropped_factors(),
                    variables: staged.dropped_variables(),
                });
                diagnose::singular(&self.graph, &self.blocks, dropped, variable).into()
            }
            Failure::Overflow { variable } => {
                SmootherError::Overflow { variable: self.graph.variable_id(variable) }
            }
            Failure::Pending => {
                unreachable!("without a pending relinearization nothing is pending")
            }
        }
    }
}
