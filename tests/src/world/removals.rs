//! Nodes removed from a world, each removal held against dense algebra, and removals that have to be
//! refused.

use evergraph::factors::RootShift;
use evergraph::model::{GraphError, Key, LieGroup, Pose2, Value, VariableId};
use evergraph::removal::{
    Guard, Offset, Options, Order, Plan, Recovery, Removal, RemovalError, Topology,
};
use evergraph::{Settings, Smoother, SmootherError};

use crate::dim_of;

use super::seen::{At, Seen, one_by_one};
use super::{Variable, World};

/// What removals have done in a world, so that a test can tell that it tested something.
#[derive(Clone, Copy, Debug, Default)]
pub struct Removals {
    /// Nodes that are gone.
    pub nodes: usize,
    /// Steps whose target had a lower rank than its blanket has dimensions.
    pub deficient: usize,
    /// Steps that did not take the form that was asked for.
    pub fallbacks: usize,
    /// Removals from a blanket in the linear model, with steps to the estimate.
    pub linear: usize,
    /// Removals of which something was seen at the estimate.
    pub beyond: usize,
    /// Plans refused as stale.
    pub stale: usize,
    /// Removals that could not be planned.
    pub refused: usize,
    /// Removals that lost what they were asked to lose, and so more than the map could do without.
    pub lost: usize,
}

impl std::ops::AddAssign for Removals {
    fn add_assign(&mut self, other: Self) {
        self.nodes += other.nodes;
        self.deficient += other.deficient;
        self.fallbacks += other.fallbacks;
        self.linear += other.linear;
        self.beyond += other.beyond;
        self.stale += other.stale;
        self.refused += other.refused;
        self.lost += other.lost;
    }
}

/// Smallest pivot ratio of a map in which some direction may be known to less than 1e-10 of what its
/// variables are known to, which counts as nothing when a node is removed: the pivots, that is the
/// roots of their ratios, are larger than the smallest singular value.
const WEAKEST: f64 = 1e-15;

/// All ways to remove, with the order.
fn ways(how: u8) -> (Options, Order) {
    let tree = Options::tree().with_least_weight(0.0);
    let dense = tree.with_topology(Topology::Dense);
    let nonlinear = tree.with_recovery(Recovery::Nonlinear);
    let ways = [
        tree,
        dense,
        nonlinear,
        tree.with_root_shift(RootShift::InverseRoot),
        dense.with_root_shift(RootShift::None),
        tree.with_intra_clique(false),
        dense.with_intra_clique(false),
        nonlinear.with_guard(Guard::default().with_rotation(1e-3).with_mahalanobis(0.1)),
        Options::paper().with_least_weight(0.0),
        Options::isam().with_least_weight(0.0),
        tree.with_recovery(Recovery::Composition),
        tree.with_recovery(Recovery::Drop),
    ];
    let orders = [Order::Given, Order::MinDegree, Order::Random(u64::from(how)), Order::MinLoss];
    let how = usize::from(how);
    (ways[how % ways.len()], orders[how / ways.len() % orders.len()])
}

/// Whether what is known stays known, by the options.
fn keeps(options: &Options) -> bool {
    matches!(options.recovery, Recovery::Glc | Recovery::Nonlinear)
        && options.offset == Offset::KeepGradient
}

impl World {
    fn node(&self, which: usize) -> VariableId {
        self.variables[which % self.variables.len()].id()
    }

    fn plan(
        &self,
        nodes: &[VariableId],
        options: Options,
        order: Order,
    ) -> Result<Plan, RemovalError> {
        let mut covariances = self.smoother.covariances();
        let mut removal = Removal::new(self.smoother.graph(), &self.smoother).with_options(options);
        if order == Order::MinLoss {
            removal = removal.priced_by(&mut covariances);
        }
        removal.plan_many(nodes, order)
    }

    /// Removes nodes, and compares the information and the gradient of what is kept with those of
    /// the full graph, the nodes eliminated.
    pub(super) fn remove(&mut self, which: usize, more: u8, how: u8) {
        let (options, order) = ways(how);
        let count = (1 + usize::from(more) % 4).min(self.variables.len());
        let mut nodes: Vec<VariableId> = (0..count).map(|k| self.node(which % 97 + k)).collect();
        let before = self.smoother.fingerprint();
        let mut plan = self.plan(&nodes, options, order);
        while let (Err(RemovalError::NoBlanket { variable }), true) = (&plan, nodes.len() > 1) {
            // The others perhaps.
            nodes.retain(|node| node != variable);
            plan = self.plan(&nodes, options, order);
        }
        let plan = match plan {
            Ok(plan) => plan,
            Err(error) => {
                let expected = match error {
                    RemovalError::NoBlanket { .. } | RemovalError::LastPose { .. } => true,
                    RemovalError::NotComposable { .. } | RemovalError::NotRepresentable { .. } => {
                        options.recovery == Recovery::Composition
                    }
                    // A map that knows something next to nothing only.
                    RemovalError::Covariance { .. } => order == Order::MinLoss,
                    _ => false,
                };
                assert!(expected, "{options:?} {order:?}: {error}");
                self.removals.refused += 1;
                return;
            }
        };
        let (graph, seen) = (self.smoother.graph().clone(), Seen::of(&self.smoother));
        let weakest = self.smoother.smallest_pivot_ratio();
        match self.smoother.apply(plan.change().clone()) {
            Ok(_) => self.removals.nodes += nodes.len(),
            Err(error) => {
                // What must not be lost is not, so that only a loss that was asked for can do this; or
                // a direction of which so little was known that it counts as nothing.
                let lost = matches!(error, SmootherError::Singular(_));
                assert!(lost && (!keeps(&options) || weakest < WEAKEST), "{options:?}: {error}");
                assert_eq!(self.smoother.fingerprint(), before, "a refusal alters nothing");
                self.removals.lost += 1;
                return;
            }
        }
        for step in plan.steps() {
            let members = || step.removed.iter().chain(&step.blanket);
            let is_beyond = members().any(|&id| seen.is_beyond(id));
            self.removals.beyond += usize::from(is_beyond);
            self.removals.linear += usize::from(!is_beyond && members().any(|&id| seen.is_off(id)));
            let dim: usize = step.blanket.iter().map(|id| dim_of(&graph, *id)).sum();
            self.removals.deficient += usize::from(step.rank < dim);
            self.removals.fallbacks += usize::from(step.fallback.is_some());
        }
        if keeps(&options) {
            let what = format!("{options:?} {order:?}: {:?}", plan.steps());
            let (before, after) = (At(&graph, &seen), At(self.smoother.graph(), &seen));
            if options.topology == Topology::Dense {
                before.check(&nodes, after, true, &what);
            } else {
                one_by_one(before, plan.steps(), options, after, &what);
            }
        }
        self.forget(&nodes);
    }

    fn forget(&mut self, nodes: &[VariableId]) {
        for variable in &self.variables {
            if let (Variable::Pose2(key, _), true) = (variable, nodes.contains(&variable.id())) {
                self.stale = Some(*key);
            }
        }
        self.variables.retain(|variable| !nodes.contains(&variable.id()));
    }

    /// A plan that something has overtaken is refused, and leaves every bit.
    pub(super) fn stale_plan(&mut self, which: usize, how: u8) {
        let node = self.node(which);
        let Ok(plan) = self.plan(&[node], ways(how).0, Order::Given) else { return };
        let blanket = plan.steps()[0].blanket.clone();
        let Some(&neighbor) = blanket.get(usize::from(how) % blanket.len().max(1)) else { return };
        let place = |id| self.variables.iter().position(|v| v.id() == id).expect("it is there");
        let applied = self.smoother.steps();
        match how / 64 {
            // A linearization point moves: of the node or of a neighbour.
            0 => self.move_point(place(neighbor)),
            1 => self.move_point(place(node)),
            // A factor comes in.
            2 => {
                let variable = self.variables[place(neighbor)].clone();
                let prior = super::MAKERS.iter().find(|m| m.kinds == [variable.kind()]);
                let factor = prior.expect("there is one for every kind").make(
                    std::slice::from_ref(&variable),
                    &mut self.wiggle,
                    None,
                );
                let mut change = self.smoother.change();
                change.add_shared_factor(factor);
                self.apply(change, "a factor beside a plan");
            }
            // The same removal.
            _ => {
                if self.smoother.apply(plan.change().clone()).is_ok() {
                    self.forget(&[node]);
                }
            }
        }
        if self.smoother.steps() == applied {
            return;
        }
        let before = self.smoother.fingerprint();
        let error = match self.smoother.apply(plan.into_change()) {
            Ok(_) => panic!("a stale plan was applied"),
            Err(error) => error,
        };
        let expected = matches!(
            error,
            SmootherError::Graph(GraphError::Stale { .. } | GraphError::UnknownVariable { .. })
        );
        assert!(expected, "{error}");
        assert_eq!(self.smoother.fingerprint(), before, "a stale plan left something behind");
        self.removals.stale += 1;
    }

    /// What cannot be planned says why. (A plan reads only: there is nothing that it could alter.)
    pub(super) fn fail_removal(&mut self, which: usize, how: u8) {
        let node = self.node(which);
        let estimates = self.smoother.estimates().expect("our types do not panic");
        let nan = |id: VariableId| -> Result<Value, GraphError> {
            let value = estimates.value(id)?.to_value();
            let step = vec![f64::NAN; value.dim()];
            Ok(value.retract(&step).expect("the step has its dimension"))
        };
        let default = Options::tree();
        let plan = |nodes: &[VariableId], options| {
            let result = self.plan(nodes, options, Order::Given);
            result.err().unwrap_or_else(|| panic!("failure {} was planned", how % 7))
        };
        let foreign: Key<Pose2> = {
            let other = Smoother::new(Settings::default()).expect("sound settings");
            other.change().add_variable(&Pose2::identity())
        };
        let expected = match how % 7 {
            0 => matches!(plan(&[], default), RemovalError::Nothing),
            1 => matches!(plan(&[node, node], default), RemovalError::Twice { .. }),
            2 => matches!(
                plan(&[node, foreign.id()], default),
                RemovalError::Graph(GraphError::Foreign { .. })
            ),
            3 => self.stale.is_none_or(|stale| {
                let error = plan(&[stale.id()], default);
                matches!(error, RemovalError::Graph(GraphError::UnknownVariable { .. }))
            }),
            4 => {
                let guard = Guard::default().with_rotation(f64::NAN);
                matches!(plan(&[node], default.with_guard(guard)), RemovalError::Option { .. })
            }
            5 => {
                let all: Vec<VariableId> = self.variables.iter().map(Variable::id).collect();
                let error = plan(&all, default);
                matches!(error, RemovalError::LastPose { .. } | RemovalError::NoBlanket { .. })
            }
            _ => {
                let error = Removal::new(self.smoother.graph(), &nan).plan(node);
                matches!(
                    error,
                    Err(RemovalError::NonFiniteEstimate { .. }
                        | RemovalError::NoBlanket { .. }
                        | RemovalError::LastPose { .. })
                )
            }
        };
        assert!(expected, "failure {}", how % 7);
        self.removals.refused += 1;
    }
}
