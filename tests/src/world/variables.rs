//! Choosing variables of a world, and adding new ones.

use evergraph::model::{
    Change, Key, LieGroup, Manifold, Point2, Point3, Pose2, Pose3, Rot2, Rot3, VectorN,
};

use super::{Kind, Variable, Wiggle, World};

impl World {
    /// Distinct variables of these kinds.
    pub(super) fn choose(&self, kinds: &[Kind], pick: usize) -> Option<Vec<Variable>> {
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
    pub(super) fn add(
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
    pub(super) fn copy(&mut self, change: &mut Change, of: &Variable) -> Variable {
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
}
