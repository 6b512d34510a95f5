//! Random operations on a world, good and bad.

use std::num::NonZeroU32;

use evergraph::model::{
    Arguments, Change, Factor, FactorId, GraphError, Kernel, Key, LieGroup, Linearization,
    Manifold, Noise, Point2, Point3, Pose2, Pose3, Rot2, Rot3, VariableId, VariableType, VectorN,
};
use evergraph::solver::{BatchSettings, Elimination, Fluid, Relinearization};
use evergraph::{Settings, Smoother, SmootherError};

use super::{Kind, MAKERS, Maker, Variable, Wiggle};

/// What happens next. Numbers choose among what there is, whatever there is.
#[derive(Clone, Debug)]
pub enum Operation {
    /// A variable of some kind, with a measurement that determines it.
    Extend {
        /// Which kind.
        kind: u8,
        /// The variable that it is measured from.
        from: usize,
        /// How far its heading turns (rad).
        turn: f64,
    },
    /// A variable and a single measurement of any kind, which may not determine it.
    Weak {
        /// Which measurement.
        maker: usize,
        /// Variables.
        pick: usize,
    },
    /// A measurement of any kind between variables that are there.
    Measure {
        /// Which measurement.
        maker: usize,
        /// Variables.
        pick: usize,
        /// Whether it stands under a robust kernel.
        robust: bool,
    },
    /// Takes a factor out.
    DropFactor(usize),
    /// Takes a variable out, with its factors.
    DropVariable(usize),
    /// Takes a variable out and puts one of the same kind in its place, in one change.
    Replace(usize),
    /// Moves a linearization point.
    Move(usize),
    /// Something that has to be refused.
    Fail(u8),
    /// Relinearizes everything to convergence.
    Relinearize,
    /// Optimizes.
    Optimize,
}

/// A smoother, and the truth of what is in it.
#[derive(Debug)]
pub struct World {
    /// The smoother.
    pub smoother: Smoother,
    variables: Vec<Variable>,
    /// A key that went out of date.
    stale: Option<Key<Pose2>>,
    wiggle: Wiggle,
    /// How often each of [`MAKERS`] has been applied.
    pub applied: Vec<usize>,
    /// Operations refused, as they had to be or for want of information.
    pub refused: usize,
}

/// A factor whose residual is not a number.
#[derive(Debug)]
struct NotANumber([VariableId; 1]);

impl Factor for NotANumber {
    fn name(&self) -> String {
        "NotANumber".into()
    }
    fn keys(&self) -> &[VariableId] {
        &self.0
    }
    fn residual_dim(&self) -> usize {
        1
    }
    fn accepts(&self, _: usize, _: &VariableType, _: usize) -> bool {
        true
    }
    fn residual(&self, _: &Arguments<'_>, out: &mut [f64]) {
        out[0] = f64::NAN;
    }
    fn linearize(&self, at: &Arguments<'_>, out: &mut Linearization<'_>) {
        self.residual(at, out.residual_mut());
    }
    fn as_any(&self) -> &dyn std::any::Any {
        self
    }
}

impl World {
    /// A pose in the plane and a pose in space, each with a prior.
    ///
    /// # Panics
    /// When the smoother refuses them.
    pub fn new(elimination: Elimination) -> Self {
        let every = |n| NonZeroU32::new(n).expect("not 0");
        let settings = Settings {
            elimination,
            relinearization: Relinearization {
                fluid: Some(Fluid { threshold: 0.01, every: every(3) }),
                sweep: None,
                batch: Some(every(23)),
            },
            ..Settings::default()
        };
        let smoother = Smoother::new(settings).unwrap_or_else(|error| panic!("{error}"));
        let mut world = Self {
            smoother,
            variables: Vec::new(),
            stale: None,
            wiggle: Wiggle::default(),
            applied: vec![0; MAKERS.len()],
            refused: 0,
        };
        for kind in [Kind::Pose2, Kind::Pose3] {
            world.extend(kind, None, 0.0);
        }
        world
    }

    /// Performs an operation.
    ///
    /// # Panics
    /// When something is accepted that must not be, refused for a reason that does not hold, or
    /// leaves anything behind though it was refused.
    pub fn run(&mut self, operation: &Operation) {
        if self.variables.is_empty() && !matches!(operation, Operation::Extend { .. }) {
            return;
        }
        match *operation {
            Operation::Extend { kind, from, turn } => {
                let kinds = [
                    Kind::Pose2,
                    Kind::Pose2,
                    Kind::Pose3,
                    Kind::Pose3,
                    Kind::Point2,
                    Kind::Point2,
                    Kind::Point3,
                    Kind::Point3,
                    Kind::Rot2,
                    Kind::Rot3,
                    Kind::Vector,
                ];
                self.extend(kinds[usize::from(kind) % kinds.len()], Some(from), turn);
            }
            Operation::Weak { maker, pick } => self.weak(maker, pick),
            Operation::Measure { maker, pick, robust } => self.measure(maker, pick, robust),
            Operation::DropFactor(which) => {
                let mut change = self.smoother.change();
                let factors: Vec<FactorId> =
                    self.smoother.graph().factors().map(|(id, _)| id).collect();
                change.drop_factor(factors[which % factors.len()]);
                self.apply(change, "dropping a factor");
            }
            Operation::DropVariable(which) => self.drop_variable(which),
            Operation::Replace(which) => self.replace(which),
            Operation::Move(which) => self.move_point(which),
            Operation::Fail(how) => self.fail(how),
            Operation::Relinearize => {
                let before = self.smoother.fingerprint();
                if let Err(error) = self.smoother.relinearize_batch() {
                    self.check_refusal(before, &error, "relinearizing");
                }
            }
            Operation::Optimize => {
                let before = (self.smoother.fingerprint(), self.smoother.error());
                match self.smoother.optimize(&BatchSettings::default()) {
                    Ok(report) => assert!(
                        report.error <= before.1 * (1.0 + 1e-12),
                        "the error rose from {} to {}",
                        before.1,
                        report.error
                    ),
                    Err(error) => self.check_refusal(before.0, &error, "optimizing"),
                }
            }
        }
    }

    // --- What can go well ------------------------------------------------------------------

    fn extend(&mut self, kind: Kind, from: Option<usize>, turn: f64) {
        let mut change = self.smoother.change();
        let sources: Vec<Variable> =
            self.variables.iter().filter(|v| observes(v.kind(), kind)).cloned().collect();
        let source = from.and_then(|from| {
            let newest = sources.len().checked_sub(1)?;
            // Mostly onwards from the newest; now and then from anywhere.
            let at = if from.is_multiple_of(4) { from / 4 % sources.len() } else { newest };
            Some(sources[at].clone())
        });
        let variable = self.add(&mut change, kind, source.as_ref(), turn);
        let ends: Vec<Variable> = source.into_iter().chain([variable.clone()]).collect();
        let kinds: Vec<Kind> = ends.iter().map(Variable::kind).collect();
        let full = ["Prior<", "Between<", "RelativePosition"];
        let maker = (0..MAKERS.len()).find(|&m| {
            MAKERS[m].kinds == kinds && full.iter().any(|name| MAKERS[m].name.starts_with(name))
        });
        let maker = maker.expect("there is a full measurement of every kind of variable");
        let factor = MAKERS[maker].make(&ends, &mut self.wiggle, None);
        change.add_shared_factor(factor);
        if self.apply(change, "extending") {
            self.applied[maker] += 1;
            self.variables.push(variable);
        }
    }

    fn weak(&mut self, maker: usize, pick: usize) {
        let maker = maker % MAKERS.len();
        let kinds = MAKERS[maker].kinds;
        let mut change = self.smoother.change();
        let Some(mut ends) = self.choose(&kinds[..kinds.len() - 1], pick) else { return };
        let source = ends.first().cloned();
        let source = source.filter(|v| observes(v.kind(), kinds[kinds.len() - 1]));
        ends.push(self.add(&mut change, kinds[kinds.len() - 1], source.as_ref(), 0.3));
        change.add_shared_factor(MAKERS[maker].make(&ends, &mut self.wiggle, None));
        if self.apply(change, MAKERS[maker].name) {
            self.applied[maker] += 1;
            self.variables.extend(ends.pop());
        }
    }

    fn measure(&mut self, maker: usize, pick: usize, robust: bool) {
        let maker = maker % MAKERS.len();
        let Some(ends) = self.choose(MAKERS[maker].kinds, pick) else { return };
        let kernel = robust.then(|| Kernel::huber(1.345).expect("a sound threshold"));
        let factor = MAKERS[maker].make(&ends, &mut self.wiggle, kernel);
        let mut change = self.smoother.change();
        change.add_shared_factor(factor);
        if self.apply(change, MAKERS[maker].name) {
            self.applied[maker] += 1;
        }
    }

    fn drop_variable(&mut self, which: usize) {
        let at = which % self.variables.len();
        let variable = self.variables[at].clone();
        let mut change = self.smoother.change();
        change
            .drop_variable_and_factors(self.smoother.graph(), variable.id())
            .expect("the variable is there");
        if self.apply(change, "dropping a variable") {
            self.variables.remove(at);
            if let Variable::Pose2(key, _) = variable {
                self.stale = Some(key);
            }
        }
    }

    /// Drops a variable and puts in another with measurements of the same kinds.
    fn replace(&mut self, which: usize) {
        let at = which % self.variables.len();
        let old = self.variables[at].clone();
        let mut change = self.smoother.change();
        change
            .drop_variable_and_factors(self.smoother.graph(), old.id())
            .expect("the variable is there");
        let new = self.copy(&mut change, &old);
        let prior = MAKERS
            .iter()
            .find(|maker| maker.name.starts_with("Prior") && maker.kinds == [new.kind()])
            .expect("there is a prior for every kind");
        change.add_shared_factor(prior.make(std::slice::from_ref(&new), &mut self.wiggle, None));
        // What stood between the old one and a neighbour, as far as a full measurement knows it.
        for position in 0..self.variables.len() {
            let other = self.variables[position].clone();
            let shared = self.smoother.graph().factors_of(old.id()).expect("it is there");
            let touches = |f: &FactorId| {
                self.smoother
                    .graph()
                    .factor(*f)
                    .is_ok_and(|factor| factor.keys().contains(&other.id()))
            };
            if position == at || !shared.iter().any(touches) {
                continue;
            }
            let ends = [other, new.clone()];
            let kinds = [ends[0].kind(), ends[1].kind()];
            let between = MAKERS.iter().find(|maker| maker.kinds == kinds);
            if let Some(maker) = between {
                change.add_shared_factor(maker.make(&ends, &mut self.wiggle, None));
            }
        }
        if self.apply(change, "replacing a variable") {
            self.variables[at] = new;
        }
    }

    fn move_point(&mut self, which: usize) {
        let variable = self.variables[which % self.variables.len()].id();
        let mut change = self.smoother.change();
        let estimate = self.smoother.estimate_value(variable).expect("the variable is there");
        let step = self.wiggle.vector(estimate.dim(), 0.05);
        change.move_value(variable, estimate.retract(&step).expect("the step has its dimension"));
        self.apply(change, "moving a linearization point");
    }

    // --- What must go wrong ----------------------------------------------------------------

    fn fail(&mut self, how: u8) {
        let mut change = self.smoother.change();
        let some = self.variables[usize::from(how) % self.variables.len()].clone();
        let noise = |dim| Noise::isotropic(dim, 0.1).expect("a sound sigma");
        let prior = |key: Key<Pose2>| {
            evergraph::factors::Prior::new(key, Pose2::identity(), noise(3)).expect("sound numbers")
        };
        match how % 9 {
            0 => {
                change.add_variable(&Point3::new(0.0, 0.0, 0.0));
            }
            1 => {
                let a = change.add_variable(&Pose2::identity());
                let b = change.add_variable(&Pose2::identity());
                let z = Pose2::new(1.0, 0.0, 0.0);
                let between = evergraph::factors::BetweenPose2::new(a, b, z, noise(3));
                change.add_factor(between.expect("sound numbers"));
            }
            2 => {
                change.add_factor(NotANumber([some.id()]));
            }
            3 => {
                let start = change.add_variable(&Pose2::new(f64::INFINITY, 0.0, 0.0));
                change.add_factor(prior(start));
            }
            4 => {
                let Some(stale) = self.stale else { return };
                change.add_factor(prior(stale));
            }
            5 => {
                // Held by its factors, all of which stay.
                change.drop_variable(some.id());
            }
            6 => {
                let factors = self.smoother.graph().factors_of(some.id()).expect("it is there");
                let Some(&factor) = factors.first() else { return };
                change.drop_factor(factor).drop_factor(factor);
            }
            7 => {
                change = Smoother::new(Settings::default()).expect("sound settings").change();
                let start = change.add_variable(&Pose2::identity());
                change.add_factor(prior(start));
            }
            _ => {
                change.move_value(some.id(), evergraph::model::Value::new(&VectorN::zeros(5)));
            }
        }
        let before = self.smoother.fingerprint();
        let error = match self.smoother.apply(change) {
            Ok(_) => panic!("failure {} was accepted", how % 9),
            Err(error) => error,
        };
        assert_eq!(self.smoother.fingerprint(), before, "failure {} left traces", how % 9);
        let expected = match how % 9 {
            0 | 1 => matches!(error, SmootherError::Singular(_)),
            2 => matches!(error, SmootherError::NonFinite { .. }),
            3 => matches!(error, SmootherError::Graph(GraphError::NonFiniteValue { .. })),
            4 => matches!(error, SmootherError::Graph(GraphError::UnknownVariable { .. })),
            5 => matches!(error, SmootherError::Graph(GraphError::StillHeld { .. })),
            6 => matches!(error, SmootherError::Graph(GraphError::Twice { .. })),
            7 => matches!(error, SmootherError::Graph(GraphError::Foreign { .. })),
            _ => matches!(error, SmootherError::Graph(GraphError::ValueMismatch { .. })),
        };
        assert!(expected, "failure {}: {error}", how % 9);
        self.refused += 1;
    }

    /// Applies a change that may be refused for want of information only.
    fn apply(&mut self, change: Change, what: &str) -> bool {
        let before = self.smoother.fingerprint();
        match self.smoother.apply(change) {
            Ok(report) => {
                assert_eq!(report.rank, self.smoother.graph().dim(), "{what}");
                assert!(report.smallest_pivot_ratio > 0.0, "{what}");
                true
            }
            Err(error) => {
                self.check_refusal(before, &error, what);
                false
            }
        }
    }

    fn check_refusal(&mut self, before: u64, error: &SmootherError, what: &str) {
        assert!(matches!(error, SmootherError::Singular(_)), "{what}: {error}");
        assert_eq!(self.smoother.fingerprint(), before, "{what} failed and left something behind");
        self.refused += 1;
    }

    // --- Variables -------------------------------------------------------------------------

    /// Distinct variables of these kinds.
    fn choose(&self, kinds: &[Kind], pick: usize) -> Option<Vec<Variable>> {
        let mut chosen: Vec<Variable> = Vec::new();
        for (k, kind) in kinds.iter().enumerate() {
            let fits: Vec<&Variable> = self
                .variables
                .iter()
                .filter(|v| v.kind() == *kind && chosen.iter().all(|c| c.id() != v.id()))
                .collect();
            let at = (pick >> (8 * k)) % fits.len().max(1);
            chosen.push((*fits.get(at)?).clone());
        }
        Some(chosen)
    }

    /// Adds a variable ahead of `source`, or near the origin, with a start value near the truth.
    fn add(
        &mut self,
        change: &mut Change,
        kind: Kind,
        source: Option<&Variable>,
        turn: f64,
    ) -> Variable {
        let w = &mut self.wiggle;
        match kind {
            Kind::Pose2 => {
                let step = Pose2::new(1.0, w.next(0.2), turn);
                let truth = match source {
                    Some(Variable::Pose2(_, x)) => x.compose(&step),
                    _ => step,
                };
                Variable::Pose2(change.add_variable(&w.near(&truth, 0.1)), truth)
            }
            Kind::Pose3 => {
                let tilt = w.vector(2, 0.1);
                let rotation = Rot3::from_roll_pitch_yaw(tilt[0], tilt[1], turn);
                let step = Pose3::new(rotation, Point3::new(1.0, w.next(0.2), w.next(0.2)));
                let truth = match source {
                    Some(Variable::Pose3(_, x)) => x.compose(&step),
                    _ => step,
                };
                Variable::Pose3(change.add_variable(&w.near(&truth, 0.1)), truth)
            }
            Kind::Point2 => {
                let seen = Point2::new(2.0 + w.next(1.0), w.next(2.0));
                let truth = match source {
                    Some(Variable::Pose2(_, x)) => x.transform_point(&seen),
                    _ => seen,
                };
                Variable::Point2(change.add_variable(&w.near(&truth, 0.1)), truth)
            }
            Kind::Point3 => {
                let seen = Point3::new(2.0 + w.next(1.0), w.next(2.0), w.next(2.0));
                let truth = match source {
                    Some(Variable::Pose3(_, x)) => x.transform_point(&seen),
                    _ => seen,
                };
                Variable::Point3(change.add_variable(&w.near(&truth, 0.1)), truth)
            }
            Kind::Rot2 => {
                let truth = Rot2::from_angle(turn + w.next(1.0));
                Variable::Rot2(change.add_variable(&w.near(&truth, 0.1)), truth)
            }
            Kind::Rot3 => {
                let truth = Rot3::from_roll_pitch_yaw(w.next(0.3), w.next(0.3), turn);
                Variable::Rot3(change.add_variable(&w.near(&truth, 0.1)), truth)
            }
            Kind::Vector => {
                let truth = VectorN::new(w.vector(4, 2.0));
                Variable::Vector(change.add_variable(&w.near(&truth, 0.1)), truth)
            }
        }
    }

    /// Adds a variable with the truth of another.
    fn copy(&mut self, change: &mut Change, of: &Variable) -> Variable {
        fn add<V: Manifold>(change: &mut Change, truth: &V, w: &mut Wiggle) -> Key<V> {
            change.add_variable(&w.near(truth, 0.05))
        }
        let w = &mut self.wiggle;
        match of {
            Variable::Pose2(_, x) => Variable::Pose2(add(change, x, w), *x),
            Variable::Pose3(_, x) => Variable::Pose3(add(change, x, w), *x),
            Variable::Point2(_, x) => Variable::Point2(add(change, x, w), *x),
            Variable::Point3(_, x) => Variable::Point3(add(change, x, w), *x),
            Variable::Rot2(_, x) => Variable::Rot2(add(change, x, w), *x),
            Variable::Rot3(_, x) => Variable::Rot3(add(change, x, w), *x),
            Variable::Vector(_, x) => Variable::Vector(add(change, x, w), x.clone()),
        }
    }

    /// The measurement kinds that no operation has applied.
    pub fn never_applied<'a>(counts: &'a [usize]) -> impl Iterator<Item = &'static str> + 'a {
        MAKERS
            .iter()
            .zip(counts)
            .filter(|(_, count)| **count == 0)
            .map(|(maker, _): (&Maker, _)| maker.name)
    }
}

/// Whether a full measurement leads from one kind of variable to another.
fn observes(from: Kind, to: Kind) -> bool {
    match to {
        Kind::Pose2 | Kind::Point2 => from == Kind::Pose2,
        Kind::Pose3 | Kind::Point3 => from == Kind::Pose3,
        Kind::Rot2 | Kind::Rot3 => from == to,
        Kind::Vector => false,
    }
}
