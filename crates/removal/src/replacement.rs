//! The new factors of a removal: which topology they take, and where their minimum is.

use std::sync::Arc;

use evergraph_model::Factor;
use nalgebra::{DMatrix, DVector};

use crate::bounded::bounded;
use crate::covariance::CovarianceRoot;
use crate::error::{MakeError, RemovalError};
use crate::fallback::Fallback;
use crate::merge::Merged;
use crate::minimum::Minimum;
use crate::neighborhood::{Neighborhood, Read};
use crate::options::{Consistency, Guard, Offset, Options, Recovery, Topology};
use crate::overlay::Overlay;
use crate::potential::{Potential, Sum};
use crate::recover::{self, Made};
use crate::target::Target;
use crate::topology::{Tree, Unary};
use crate::whitened::{Certificate, Whitened};

/// New factors, and what they add up to.
pub(crate) struct Replacement {
    pub(crate) made: Vec<Made>,
    pub(crate) topology: Topology,
    pub(crate) fallback: Option<Fallback>,
    /// In the columns of the blanket, of new factors and of those that they are merged with.
    pub(crate) rows: DMatrix<f64>,
    /// The whitened residual at the estimate, negated: `G d`.
    pub(crate) rhs: DVector<f64>,
    /// Factors that are merged with a new one on the same variable; their rows are the last.
    pub(crate) merged: Vec<Read>,
    /// Error that no step can take away, of factors that are merged.
    pub(crate) disagreement: f64,
    pub(crate) largest_rotation: f64,
    /// As [`Guard::rotation`](crate::Guard) counts, of trees.
    pub(crate) known_rotation: f64,
    pub(crate) largest_length: f64,
    pub(crate) certificate: Option<Certificate>,
}

impl Replacement {
    pub(crate) fn nothing(target: &Target, topology: Topology) -> Self {
        Self {
            made: Vec::new(),
            topology,
            fallback: None,
            rows: DMatrix::zeros(0, target.dim()),
            rhs: DVector::zeros(0),
            merged: Vec::new(),
            disagreement: 0.0,
            largest_rotation: 0.0,
            known_rotation: 0.0,
            largest_length: 0.0,
            certificate: None,
        }
    }

    /// Composed factors, which add up to their linearization at the estimate.
    pub(crate) fn composed(
        neighborhood: &Neighborhood,
        target: &Target,
        factors: Vec<Arc<dyn Factor>>,
    ) -> Result<Self, RemovalError> {
        let mut new = Self::nothing(target, Topology::ChowLiu);
        for factor in factors {
            let read = neighborhood.read_new(&*factor)?;
            let rhs = new.append(target, neighborhood.removed, &read);
            new.largest_length = new.largest_length.max(rhs);
            new.made.push(Made { factor, linear: false });
        }
        Ok(new)
    }

    /// Adds the rows of a factor on members of the blanket, which come after the `removed` ones. Returns the length of its
    /// residual.
    fn append(&mut self, target: &Target, removed: usize, read: &Read) -> f64 {
        let (top, count, width) = (self.rows.nrows(), read.rows.nrows(), read.rows.ncols() - 1);
        self.rows = std::mem::take(&mut self.rows).resize_vertically(top + count, 0.0);
        self.rhs = std::mem::take(&mut self.rhs).resize_vertically(top + count, 0.0);
        let mut source = 0;
        for &m in &read.members {
            let columns = target.columns(m - removed);
            let mut block = self.rows.view_mut((top, columns.start), (count, columns.len()));
            block.copy_from(&read.rows.columns(source, columns.len()));
            source += columns.len();
        }
        let rhs = read.rows.column(width);
        self.rhs.rows_mut(top, count).copy_from(&rhs);
        rhs.norm()
    }

    /// The square root of the information of merged factors, and their right-hand side.
    pub(crate) fn merged_rows(&self) -> (DMatrix<f64>, DVector<f64>) {
        let count = self.merged.iter().map(|read| read.rows.nrows()).sum();
        let top = self.rows.nrows() - count;
        (self.rows.rows(top, count).into_owned(), self.rhs.rows(top, count).into_owned())
    }

    /// The share of the offset that is within the limits of a guard.
    fn allowed_share(&self, guard: &Guard) -> f64 {
        let share = |limit: f64, actual: f64| if actual > limit { limit / actual } else { 1.0 };
        let rotation = share(guard.rotation, self.known_rotation);
        rotation.min(share(guard.mahalanobis, self.largest_length))
    }
}

/// Terms with their sum.
struct Terms {
    potentials: Vec<Potential>,
    sum: Sum,
    fallback: Option<Fallback>,
    certificate: Option<Certificate>,
}

/// A target, and all that decides how it is replaced.
#[derive(Clone, Copy)]
pub(crate) struct Maker<'a> {
    pub(crate) overlay: &'a Overlay<'a>,
    pub(crate) neighborhood: &'a Neighborhood,
    pub(crate) target: &'a Target,
    pub(crate) options: &'a Options,
    /// True to compare trees with the target ([`Certificate`]).
    pub(crate) certify: bool,
}

impl Maker<'_> {
    /// The topology that was asked for, if it holds what the target holds and can be trusted, else
    /// the next closer one.
    pub(crate) fn replacement(&self) -> Result<Replacement, RemovalError> {
        let Self { target, options, .. } = *self;
        let is_auto = options.topology == Topology::Auto && options.recovery == Recovery::Glc;
        if options.topology == Topology::Dense || is_auto && target.members.len() <= 2 {
            return self.dense(None);
        }
        let covariance = CovarianceRoot::of(target);
        let unary = if options.keep_unary { Unary::OnNewest } else { Unary::OnFirst };
        let tree = Tree::chow_liu(target, covariance.as_ref(), options.mutual_information, unary);
        let Some((recovery, terms)) = self.known_terms(&tree, covariance.as_ref()) else {
            return self.dense(Some(Fallback::DenseForRank));
        };
        // Between two, a tree is what one factor would be, unless recovery splits it further.
        let is_exact = target.members.len() <= 2
            && (recovery == Recovery::Glc || terms.potentials.iter().all(|p| p.relative));
        if is_exact {
            return self.tree(&terms, recovery, &terms.sum.minimum);
        }
        if is_auto && self.is_dense_better(&terms.potentials) {
            return self.dense(None);
        }
        if options.consistency != Consistency::None && !target.is_well_conditioned() {
            return self.dense(Some(Fallback::DenseForConsistency));
        }
        let terms = self.bounded(&tree, terms);
        let new = self.tree(&terms, recovery, &terms.sum.minimum)?;
        let guard = &options.guard;
        if new.known_rotation <= guard.rotation && new.largest_length <= guard.mahalanobis {
            return Ok(new);
        }
        if target.members.len() <= guard.largest_dense {
            return self.dense(Some(Fallback::DenseForOffset));
        }
        let minimum = &terms.sum.minimum * new.allowed_share(guard);
        let terms = Terms { fallback: Some(Fallback::ShortenedOffset), ..terms };
        self.tree(&terms, recovery, &minimum)
    }

    /// The terms of a tree that hold all that the target holds, in the form that was asked for or else as linear ones.
    fn known_terms(
        &self,
        tree: &Tree,
        covariance: Option<&CovarianceRoot>,
    ) -> Option<(Recovery, Terms)> {
        let asked = self.options.recovery;
        let kinds: &[Recovery] = match asked {
            Recovery::Nonlinear => &[Recovery::Nonlinear, Recovery::Glc],
            _ => &[Recovery::Glc],
        };
        kinds.iter().find_map(|&recovery| {
            let potentials = Potential::of_tree(self.target, covariance, tree, recovery);
            let sum = Sum::of(self.target, &potentials);
            let fallback = (recovery != asked).then_some(Fallback::LinearTreeForRank);
            let is_known = sum.rank == self.target.rank();
            is_known.then_some((recovery, Terms { potentials, sum, fallback, certificate: None }))
        })
    }

    /// True if the tree loses more than the pairs are worth that only a dense factor joins ([`Topology::Auto`]).
    fn is_dense_better(&self, potentials: &[Potential]) -> bool {
        /// For each pair.
        const NATS: f64 = 1e-3;
        let n = self.target.members.len();
        let pairs = ((n - 1) * (n - 2) / 2) as f64;
        n <= self.options.dense_up_to
            && Whitened::of(self.target, potentials).divergence() > NATS * pairs
    }

    /// Terms as consistent as was asked for.
    fn bounded(&self, tree: &Tree, terms: Terms) -> Terms {
        let Self { target, options, .. } = *self;
        let bounded = match options.consistency {
            Consistency::None => None,
            consistency => bounded(target, tree, &terms.potentials, consistency),
        };
        match bounded {
            Some(bounded) => Terms {
                sum: Sum::of(target, &bounded.potentials),
                potentials: bounded.potentials,
                fallback: bounded.fallback.or(terms.fallback),
                certificate: Some(bounded.certificate),
            },
            None if self.certify => {
                let certificate = Whitened::of(target, &terms.potentials).certificate(None);
                Terms { certificate: Some(certificate), ..terms }
            }
            None => terms,
        }
    }

    fn tree(
        &self,
        terms: &Terms,
        recovery: Recovery,
        minimum: &DVector<f64>,
    ) -> Result<Replacement, RemovalError> {
        let options = Options { recovery, ..*self.options };
        let new = self.make(&terms.potentials, terms.sum.rows.clone(), minimum, &options)?;
        let Terms { fallback, certificate, .. } = *terms;
        Ok(Replacement { fallback, certificate, ..new })
    }

    /// One factor on the whole blanket.
    fn dense(&self, fallback: Option<Fallback>) -> Result<Replacement, RemovalError> {
        let Self { target, options, .. } = *self;
        let potentials = Potential::dense(target);
        let new = self.make(&potentials, target.root.clone(), &target.minimum(), options)?;
        Ok(Replacement { topology: Topology::Dense, fallback, ..new })
    }

    /// The factors of terms whose sum is least at `minimum`.
    fn make(
        &self,
        potentials: &[Potential],
        rows: DMatrix<f64>,
        minimum: &DVector<f64>,
        options: &Options,
    ) -> Result<Replacement, RemovalError> {
        let target = self.target;
        let minimum = match options.offset {
            Offset::KeepGradient => minimum.clone(),
            Offset::Zero => DVector::zeros(target.dim()),
        };
        let mut new = Replacement::nothing(target, Topology::ChowLiu);
        new.rhs = &rows * &minimum;
        new.rows = rows;
        for potential in potentials {
            let offset = potential.part(target, &minimum);
            let term = Minimum::of(target, potential, &offset);
            let rotation = term.rotation();
            new.largest_rotation = new.largest_rotation.max(rotation);
            // Most terms are near enough as they are; of dense ones nobody asks.
            let is_near = rotation <= options.guard.rotation || potential.members.len() > 2;
            let known = if is_near { rotation } else { term.known().rotation() };
            new.known_rotation = new.known_rotation.max(known);
            new.largest_length = new.largest_length.max((&potential.rows * &offset).norm());
            let made = match self.merged(potential, &offset)? {
                Some(merged) => {
                    let made = self.factor(&merged.term, &merged.offset, options)?;
                    new.disagreement += merged.disagreement;
                    for read in merged.reads {
                        new.append(target, self.neighborhood.removed, &read);
                        new.merged.push(read);
                    }
                    made
                }
                None => self.factor(potential, &offset, options)?,
            };
            new.made.extend(made);
        }
        Ok(new)
    }

    /// A term on one variable merged with the factors that are on that variable alone, if there are any.
    fn merged(
        &self,
        potential: &Potential,
        offset: &DVector<f64>,
    ) -> Result<Option<Merged>, RemovalError> {
        match potential.members[..] {
            [member] if self.options.keep_unary && self.options.intra_clique => {
                let reads = self.neighborhood.unary(self.overlay, member, self.options)?;
                Ok(Merged::of(potential, offset, reads))
            }
            _ => Ok(None),
        }
    }

    /// The factor of a term with its minimum at `offset` from the estimate.
    fn factor(
        &self,
        potential: &Potential,
        offset: &DVector<f64>,
        options: &Options,
    ) -> Result<Option<Made>, RemovalError> {
        // Counted from where the members are seen.
        let delta = potential.members.iter().flat_map(|&m| self.target.members[m].delta.iter());
        let offset = DVector::from_iterator(
            offset.len(),
            offset.iter().zip(delta).map(|(offset, delta)| offset + delta),
        );
        recover::make(self.overlay.graph, self.target, potential, &offset, options).map_err(
            |error: MakeError| {
                let members = &self.neighborhood.members[..self.neighborhood.removed];
                let removed = members.iter().map(|m| m.id).collect();
                RemovalError::NotRepresentable { removed, reason: error.to_string() }
            },
        )
    }
}
