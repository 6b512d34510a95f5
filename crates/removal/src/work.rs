//! A plan in the making: steps drafted on what the steps before them have left.

use std::collections::BTreeMap;

use evergraph_model::VariableId;
use evergraph_model::belief::{BeliefError, Covariance};

use crate::driver::{Remover, remove_in_order};
use crate::error::RemovalError;
use crate::groups::groups;
use crate::member::Member;
use crate::neighborhood::blanket;
use crate::options::{Consistency, Options, Recovery, Topology};
use crate::order::Order;
use crate::overlay::Overlay;
use crate::price::{Ledger, divergence};
use crate::queue::Loss;
use crate::step::{Draft, Step};

/// The state of a plan between two steps.
pub(crate) struct Work<'w, 'a> {
    overlay: &'w mut Overlay<'a>,
    options: &'w Options,
    covariance: Option<&'w mut dyn Covariance>,
    ledger: Ledger,
    steps: Vec<Step>,
    seen: BTreeMap<VariableId, Member>,
    /// The last draft, which is often that of the next step; good until a step is taken.
    last: Option<Draft>,
}

/// Steps, and the members of their neighborhoods as they were read.
pub(crate) struct Done {
    pub(crate) steps: Vec<Step>,
    pub(crate) seen: BTreeMap<VariableId, Member>,
}

/// Removes all of `nodes` from the overlay.
///
/// An exact removal does not depend on the order, so that connected groups are removed at once. Trees go node by node.
pub(crate) fn remove_all<'w>(
    overlay: &'w mut Overlay<'_>,
    nodes: &[VariableId],
    order: Order,
    options: &'w Options,
    covariance: Option<&'w mut dyn Covariance>,
) -> Result<Done, RemovalError> {
    let is_exact = options.topology == Topology::Dense
        && matches!(options.recovery, Recovery::Glc | Recovery::Nonlinear);
    if !is_exact && order == Order::MinLoss && covariance.is_none() {
        return Err(RemovalError::NeedsCovariance);
    }
    let mut work = Work {
        overlay,
        options,
        covariance,
        ledger: Ledger::default(),
        steps: Vec::new(),
        seen: BTreeMap::new(),
        last: None,
    };
    if is_exact {
        // Factors of fixed nodes stay, with the nodes' values put in.
        let (fixed, others): (Vec<VariableId>, Vec<VariableId>) =
            nodes.iter().partition(|&&node| work.overlay.is_fixed(node));
        for node in fixed {
            let draft = work.draft(&[node])?;
            work.take(draft)?;
        }
        for group in groups(work.overlay, &others) {
            let draft = work.draft(&group)?;
            work.take(draft)?;
        }
    } else {
        remove_in_order(&mut work, nodes, order, usize::MAX)?;
    }
    Ok(Done { steps: work.steps, seen: work.seen })
}

impl Remover for Work<'_, '_> {
    type Error = RemovalError;

    fn slot(&self, node: VariableId) -> Result<usize, RemovalError> {
        Ok(self.overlay.slot(node))
    }

    fn degree(&self, node: VariableId) -> Result<usize, RemovalError> {
        Ok(blanket(self.overlay, &[node]).len())
    }

    fn prices(&mut self) -> impl FnMut(VariableId) -> Result<Loss, RemovalError> {
        |node| {
            let draft = self.draft(&[node])?;
            Ok(Loss::of(&self.last.insert(draft).step))
        }
    }

    fn remove(
        &mut self,
        node: VariableId,
        _: Option<Loss>,
    ) -> Result<Option<Vec<VariableId>>, RemovalError> {
        let draft = match self.last.take() {
            Some(draft) if draft.step.removed == [node] => draft,
            _ => self.draft(&[node])?,
        };
        let touched = draft.step.blanket.clone();
        self.take(draft)?;
        Ok(Some(touched))
    }
}

impl Work<'_, '_> {
    /// Plans a step, and prices it if there is a covariance.
    fn draft(&mut self, removed: &[VariableId]) -> Result<Draft, RemovalError> {
        let certify = self.covariance.is_some() || self.options.consistency != Consistency::None;
        let mut draft = Draft::of(self.overlay, removed, self.options, certify)?;
        if draft.before.ncols() == 0 {
            // Nothing changes for a kept variable.
            draft.step.price = self.covariance.as_ref().map(|_| 0.0);
        } else if let Some(covariance) = self.covariance.as_deref_mut() {
            let blanket = &draft.step.blanket;
            let dims = self.overlay.dims(blanket);
            let refused = |source| RemovalError::Covariance { variables: blanket.clone(), source };
            let sigma = self.ledger.covariance(covariance, blanket, &dims).map_err(refused)?;
            let price = divergence(&sigma, &draft.before, &draft.after, &draft.gradient);
            draft.step.price =
                Some(price.ok_or_else(|| refused(BeliefError::NotPositiveDefinite))?);
        }
        Ok(draft)
    }

    /// Makes a step part of the plan.
    fn take(&mut self, draft: Draft) -> Result<(), RemovalError> {
        // Other poses may have been removed since it was drafted.
        self.overlay.check_last_pose(&draft.step.removed, &draft.step.blanket)?;
        let Draft { mut step, factors, before, after, seen, .. } = draft;
        self.seen.extend(seen.into_iter().map(|member| (member.id, member)));
        let dropped = step.absorbed.iter().chain(&step.rejected).copied();
        step.first_new = self.overlay.apply(&step.removed, dropped, &factors);
        if self.covariance.is_some() && before.ncols() > 0 {
            let dims = self.overlay.dims(&step.blanket);
            self.ledger.note(step.blanket.clone(), dims, before, after);
        }
        self.steps.push(step);
        Ok(())
    }
}
