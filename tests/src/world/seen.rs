//! What a removal is held against: the linear model that is solved, by dense algebra.

use std::collections::{BTreeMap, BTreeSet};

use evergraph::Smoother;
use evergraph::model::{Graph, GraphError, Value, VariableId};
use evergraph::removal::{Estimates, LinearizedEstimate, Options, Removal, Step, Topology};
use nalgebra::{DMatrix, DVector};

use crate::{dim_of, stack};

/// Where a removal sees each variable, and the step from there to its estimate.
pub(super) struct Seen {
    at: BTreeMap<VariableId, LinearizedEstimate>,
    beyond: BTreeSet<VariableId>,
}

impl Seen {
    /// At the linearization point as far as [`Options::linear_within`] of the default allows, else at the
    /// estimate.
    pub(super) fn of(smoother: &Smoother) -> Self {
        let within = Options::default().linear_within;
        let mut beyond = BTreeSet::new();
        let seen = |id| {
            let delta = smoother.deltas(&[id]).expect("it is there").remove(0);
            if delta.iter().all(|x| x.abs() <= within) {
                let point = smoother.linearization_point(id).expect("it is there");
                return (id, LinearizedEstimate { point, delta });
            }
            beyond.insert(id);
            let point = smoother.estimate_value(id).expect("it is there");
            (id, LinearizedEstimate { delta: vec![0.0; point.dim()], point })
        };
        let at = smoother.graph().variables().map(seen).collect();
        Self { at, beyond }
    }

    /// Whether it is seen at the estimate, too far from its linearization point.
    pub(super) fn is_beyond(&self, id: VariableId) -> bool {
        self.beyond.contains(&id)
    }

    /// Whether its estimate is a step away from where it is seen.
    pub(super) fn is_off(&self, id: VariableId) -> bool {
        self.at.get(&id).is_some_and(|it| it.delta.iter().any(|&x| x != 0.0))
    }

    fn at(&self, id: VariableId) -> Result<&LinearizedEstimate, GraphError> {
        self.at.get(&id).ok_or(GraphError::UnknownVariable { variable: id })
    }
}

impl Estimates for Seen {
    fn estimate(&self, variable: VariableId) -> Result<Value, GraphError> {
        let LinearizedEstimate { point, delta } = self.at(variable)?;
        Ok(point.retract(delta).expect("the step has its dimension"))
    }

    fn linearized(
        &self,
        variables: &[VariableId],
    ) -> Result<Option<Vec<LinearizedEstimate>>, GraphError> {
        variables.iter().map(|&id| self.at(id).cloned()).collect::<Result<_, _>>().map(Some)
    }
}

/// The linear model of a graph.
#[derive(Clone, Copy)]
pub(super) struct At<'a>(pub(super) &'a Graph, pub(super) &'a Seen);

/// Trees are put in the place of nodes one after the other, as if each step of the plan had been
/// applied before the next was planned; each keeps the gradient.
pub(super) fn one_by_one(
    before: At<'_>,
    steps: &[Step],
    options: Options,
    after: At<'_>,
    what: &str,
) {
    let seen = before.1;
    let mut graph = before.0.clone();
    for step in steps {
        let node = step.removed[0];
        let mut next = graph.clone();
        let (change, exact) = if step.blanket.is_empty() {
            // Nothing is known any more between it and the rest.
            let mut change = graph.change();
            change.drop_variable_and_factors(&graph, node).expect("the node is there");
            (change, true)
        } else {
            let plan = Removal::new(&graph, seen).with_options(options).plan(node);
            let plan = plan.unwrap_or_else(|error| panic!("{what}: {error}"));
            let exact = plan.steps()[0].topology == Topology::Dense;
            (plan.into_change(), exact)
        };
        let staged = next.stage(&change).unwrap_or_else(|error| panic!("{what}: {error}"));
        next.commit(staged);
        At(&graph, seen).check(&step.removed, At(&next, seen), exact, what);
        graph = next;
    }
    At(&graph, seen).check(&[], after, true, what);
}

impl At<'_> {
    /// `(J, r + Jδ)`.
    fn stack(self, order: &[VariableId]) -> (DMatrix<f64>, DVector<f64>) {
        let at = |id| self.1.at(id).expect("it was there");
        let (jacobian, residual) = stack(self.0, order, |id| at(id).point.clone());
        let delta = order.iter().flat_map(|&id| at(id).delta.iter().copied());
        let step = &jacobian * DVector::from_vec(delta.collect());
        (jacobian, residual + step)
    }

    /// Holds a graph without the variables `gone` against this one: the gradient of the others,
    /// and if `exact` their information, are those of this graph with `gone` eliminated, `J_k` and
    /// `r` less their parts in the range of `J_m`.
    pub(super) fn check(self, gone: &[VariableId], reduced: At<'_>, exact: bool, what: &str) {
        let kept: Vec<VariableId> = self.0.variables().filter(|id| !gone.contains(id)).collect();
        let order: Vec<VariableId> = gone.iter().chain(&kept).copied().collect();
        let width: usize = gone.iter().map(|id| dim_of(self.0, *id)).sum();
        let (jacobian, mut left) = self.stack(&order);
        let mut rest = jacobian.columns(width, jacobian.ncols() - width).into_owned();
        let scale: Vec<f64> = rest.column_iter().map(|column| column.norm()).collect();
        let floor = 1e-3 * scale.iter().copied().fold(0.0, f64::max);
        let scale: Vec<f64> = scale.into_iter().map(|s| s.max(floor)).collect();
        let size = left.norm().max(1.0);
        if width > 0 {
            let mut of_nodes = jacobian.columns(0, width).into_owned();
            of_nodes.column_iter_mut().for_each(|mut column| {
                column.normalize_mut();
            });
            let q = of_nodes.qr().q();
            // Twice, so that nothing is left in the range.
            for _ in 0..2 {
                rest -= &q * q.tr_mul(&rest);
                left -= &q * q.tr_mul(&left);
            }
        }
        let (new, new_residual) = reduced.stack(&kept);
        let (expected, found) = (rest.tr_mul(&left), new.tr_mul(&new_residual));
        for (i, s) in scale.iter().enumerate() {
            let off = (expected[i] - found[i]).abs();
            // To the root of the precision where a direction is all but free.
            assert!(off <= 3e-8 * s * size, "{what}: gradient {i} is off by {off:e}");
        }
        if exact {
            let (expected, found) = (rest.tr_mul(&rest), new.tr_mul(&new));
            for (i, s) in scale.iter().enumerate() {
                for (j, t) in scale.iter().enumerate() {
                    let off = (expected[(i, j)] - found[(i, j)]).abs();
                    assert!(off <= 1e-9 * s * t, "{what}: information ({i}, {j}) off by {off:e}");
                }
            }
        }
    }
}
