//! Random operations on a world, good and bad.

use std::num::NonZeroU32;

use evergraph::model::{Change, FactorId, Kernel, Key, Pose2, VariableId};
use evergraph::solver::{BatchSettings, Elimination, Fluid, Relinearization};
use evergraph::{Settings, Smoother, SmootherError};

use super::{Kind, MAKERS, Maker, Removals, Variable, Wiggle};

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
    /// Removes nodes, keeping what they know (but where asked to lose it).
    Remove {
        /// The first of the nodes.
        which: usize,
        /// How many, less one.
        more: u8,
        /// How.
        how: u8,
    },
    /// Plans a removal, changes something that it read, and applies it.
    Stale {
        /// The node.
        which: usize,
        /// What changes.
        how: u8,
    },
    /// A removal that cannot be planned.
    FailRemoval {
        /// The node.
        which: usize,
        /// Why not.
        how: u8,
    },
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
    pub(super) variables: Vec<Variable>,
    /// A key that went out of date.
    pub(super) stale: Option<Key<Pose2>>,
    pub(super) wiggle: Wiggle,
    /// How often each of [`MAKERS`] has been applied.
    pub applied: Vec<usize>,
    /// What removals have done.
    pub removals: Removals,
    /// Operations refused, as they had to be or for want of information.
    pub refused: usize,
}

impl World {
    /// A pose in the plane and a pose in space, each with a prior.
    ///
    /// # Panics
    /// When the smoother refuses them.
    pub fn new(elimination: Elimination) -> Self {
        Self::on_threads(elimination, 1)
    }

    /// [`new`](Self::new) with a number of threads.
    ///
    /// # Panics
    /// As [`new`](Self::new).
    pub fn on_threads(elimination: Elimination, threads: usize) -> Self {
        let every = |n| NonZeroU32::new(n).expect("not 0");
        let settings = Settings::default()
            .with_elimination(elimination)
            .with_threads(threads)
            .with_relinearization(
                Relinearization::NEVER
                    .with_fluid(Some(Fluid::new(0.2, 0.4, every(5)))) // at once
                    .with_sweep(Some(Fluid::new(0.01, 0.4, every(3)))) // in slices
                    .with_spread(every(4))
                    .with_batch(Some(every(23))),
            );
        let smoother = Smoother::new(settings).unwrap_or_else(|error| panic!("{error}"));
        let mut world = Self {
            smoother,
            variables: Vec::new(),
            stale: None,
            wiggle: Wiggle::default(),
            applied: vec![0; MAKERS.len()],
            removals: Removals::default(),
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
            Operation::Remove { which, more, how } => self.remove(which, more, how),
            Operation::Stale { which, how } => self.stale_plan(which, how),
            Operation::FailRemoval { which, how } => self.fail_removal(which, how),
            Operation::Fail(how) => self.fail(how),
            Operation::Relinearize => {
                let before = self.smoother.fingerprint();
                if let Err(error) = self.smoother.relinearize_batch() {
                    self.check_refusal(before, &error, "relinearizing");
                }
            }
            Operation::Optimize => {
                let before = (
                    self.smoother.fingerprint(),
                    self.smoother.error().expect("our factors do not panic"),
                );
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

    pub(super) fn move_point(&mut self, which: usize) {
        let variable = self.variables[which % self.variables.len()].id();
        let mut change = self.smoother.change();
        let estimate = self.smoother.estimate_value(variable).expect("the variable is there");
        self.check_estimates_together();
        let step = self.wiggle.vector(estimate.dim(), 0.05);
        change.move_value(variable, estimate.retract(&step).expect("the step has its dimension"));
        self.apply(change, "moving a linearization point");
    }

    /// Several estimates at once are those of each, to the bit.
    fn check_estimates_together(&self) {
        let ids: Vec<VariableId> = self.variables.iter().map(|key| key.id()).collect();
        let together = self.smoother.estimate_values(&ids).expect("the variables are there");
        for (id, value) in ids.into_iter().zip(together) {
            assert_eq!(value, self.smoother.estimate_value(id).expect("the variable is there"));
        }
    }

    /// Applies a change that may be refused for want of information only.
    pub(super) fn apply(&mut self, change: Change, what: &str) -> bool {
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
