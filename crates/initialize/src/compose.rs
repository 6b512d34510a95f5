//! Start values along a single measurement.

use evergraph_factors::{
    BearingRange2, BearingRange3, BetweenPoint2, BetweenPoint3, BetweenPose2, BetweenPose3,
    LocalJacobian, Prior, RelativePosition2, RelativePosition3,
};
use evergraph_model::{
    Factor, LieGroup, Manifold, Point2, Point3, Pose2, Pose3, Value, VariableId,
};

/// The value of `target` at which a factor's residual is zero, given the values of its other variables:
/// the start value of a variable that comes in by this factor.
///
/// For factors that measure all of a variable: [`Prior`], [`BetweenPose2`], [`BetweenPose3`],
/// [`BetweenPoint2`] and [`BetweenPoint3`] in either direction, the point of [`RelativePosition2`],
/// [`RelativePosition3`], [`BearingRange2`] and [`BearingRange3`], each under a robust kernel or not.
/// `None` for other factors, for a `target` that the factor does not measure wholly, and when `known` has
/// no value for another variable.
///
/// ```
/// use evergraph_factors::BetweenPose2;
/// use evergraph_initialize::compose;
/// use evergraph_model::{Graph, Noise, Pose2, Value};
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// let mut change = Graph::new().change();
/// let here = Pose2::new(1.0, 2.0, 0.0);
/// let from = change.add_variable(&here);
/// let to = change.add_variable(&here);
/// let driven = BetweenPose2::new(from, to, Pose2::new(3.0, 0.0, 0.5), Noise::isotropic(3, 0.1)?)?;
/// let start = compose(&driven, to.id(), |_| Some(Value::new(&here))).ok_or("odometry")?;
/// assert_eq!(start.get(), Some(Pose2::new(4.0, 2.0, 0.5)));
/// # Ok(())
/// # }
/// ```
pub fn compose(
    factor: &dyn Factor,
    target: VariableId,
    known: impl FnMut(VariableId) -> Option<Value>,
) -> Option<Value> {
    let mut seen = Seen { factor, target, known };
    let priors = [seen.prior::<Pose2>(), seen.prior::<Pose3>(), seen.prior::<Point2>()];
    if let Some(value) = priors.into_iter().flatten().next().or_else(|| seen.prior::<Point3>()) {
        return Some(value);
    }
    let of_pair = seen.between_poses().or_else(|| seen.between_points());
    of_pair.or_else(|| seen.point_of_plane()).or_else(|| seen.point_in_space())
}

struct Seen<'a, K> {
    factor: &'a dyn Factor,
    target: VariableId,
    known: K,
}

impl<K: FnMut(VariableId) -> Option<Value>> Seen<'_, K> {
    fn prior<V: LocalJacobian>(&self) -> Option<Value> {
        let (prior, _) = self.factor.downcast::<Prior<V>>()?;
        (prior.key() == self.target).then(|| Value::new(prior.measurement()))
    }

    fn value<V: Manifold>(&mut self, variable: VariableId) -> Option<V> {
        (self.known)(variable)?.get()
    }

    fn between_poses(&mut self) -> Option<Value> {
        if let Some((it, _)) = self.factor.downcast::<BetweenPose2>() {
            return self.along([it.from(), it.to()], it.measurement());
        }
        let (it, _) = self.factor.downcast::<BetweenPose3>()?;
        self.along([it.from(), it.to()], it.measurement())
    }

    fn between_points(&mut self) -> Option<Value> {
        if let Some((it, _)) = self.factor.downcast::<BetweenPoint2>() {
            return self.along([it.from(), it.to()], it.measurement());
        }
        let (it, _) = self.factor.downcast::<BetweenPoint3>()?;
        self.along([it.from(), it.to()], it.measurement())
    }

    /// `to = from z`, or `from = to z⁻¹`.
    fn along<G: LieGroup<N>, const N: usize>(
        &mut self,
        [from, to]: [VariableId; 2],
        measurement: &G,
    ) -> Option<Value> {
        if self.target == to {
            return Some(Value::new(&self.value::<G>(from)?.compose(measurement)));
        }
        let at = self.target == from;
        at.then(|| Some(Value::new(&self.value::<G>(to)?.compose(&measurement.inverse()))))?
    }

    fn point_of_plane(&mut self) -> Option<Value> {
        let (pose, point, in_robot) =
            if let Some((it, _)) = self.factor.downcast::<RelativePosition2>() {
                (it.pose(), it.point(), it.measurement())
            } else {
                let (it, _) = self.factor.downcast::<BearingRange2<Point2>>()?;
                let (sin, cos) = it.bearing().sin_cos();
                (it.pose(), it.target(), Point2::new(it.range() * cos, it.range() * sin))
            };
        (point == self.target).then_some(())?;
        Some(Value::new(&self.value::<Pose2>(pose)?.transform_point(&in_robot)))
    }

    fn point_in_space(&mut self) -> Option<Value> {
        if let Some((it, _)) = self.factor.downcast::<RelativePosition3>() {
            (it.point() == self.target).then_some(())?;
            let sensor = self.value::<Pose3>(it.pose())?.compose(it.robot_from_sensor());
            return Some(Value::new(&sensor.transform_point(&it.measurement())));
        }
        let (it, _) = self.factor.downcast::<BearingRange3<Point3>>()?;
        (it.target() == self.target).then_some(())?;
        let in_robot = Point3::from(it.range() * it.direction());
        Some(Value::new(&self.value::<Pose3>(it.pose())?.transform_point(&in_robot)))
    }
}
