//! Landmarks seen from poses, in Cartesian coordinates.

use evergraph_model::{
    Arguments, Factor, Key, LieGroup, Linearization, Noise, Point2, Point3, Pose2, Pose3,
    VariableId,
};
use nalgebra::{Matrix2, Matrix2x3, Matrix3, Vector2, Vector3};

use crate::cross::times_skew;
use crate::error::{FactorError, finite_value, fixed, fixed_shape};

/// A point in the plane seen from a pose: `r = R (T⁻¹ p - z)`.
///
/// `T = world_from_robot`, `p` the point in the world, `z` the point in the robot's frame, metres.
/// With `q = T⁻¹ p` and `C` the rotation of `T`:
///
/// ```text
/// J_pose  = R [-1 0 q_y; 0 -1 -q_x]        J_point = R Cᵀ
/// ```
#[derive(Clone, Debug)]
pub struct RelativePosition2 {
    keys: [VariableId; 2],
    measurement: Point2,
    noise: Noise,
    sqrt_information: Matrix2<f64>,
}

impl RelativePosition2 {
    /// `measurement` is the place of `point` in the frame of `pose`.
    ///
    /// # Errors
    /// [`FactorError::NoiseDimension`], [`FactorError::NotFinite`].
    pub fn new(
        pose: Key<Pose2>,
        point: Key<Point2>,
        measurement: Point2,
        noise: Noise,
    ) -> Result<Self, FactorError> {
        finite_value("RelativePosition2", "measurement", &measurement)?;
        let sqrt_information = fixed("RelativePosition2", &noise)?;
        Ok(Self { keys: [pose.id(), point.id()], measurement, noise, sqrt_information })
    }

    /// The pose that sees.
    pub fn pose(&self) -> VariableId {
        self.keys[0]
    }

    /// The point that is seen.
    pub fn point(&self) -> VariableId {
        self.keys[1]
    }

    /// The point in the pose's frame.
    pub fn measurement(&self) -> Point2 {
        self.measurement
    }

    /// The noise.
    pub fn noise(&self) -> &Noise {
        &self.noise
    }

    /// The point in the robot's frame and the unwhitened residual.
    #[inline]
    fn evaluate(
        &self,
        world_from_robot: &Pose2,
        at: &Arguments<'_>,
    ) -> (Vector2<f64>, Vector2<f64>) {
        let in_robot = world_from_robot.inverse_transform_point(&at.get(1)).vector();
        (in_robot, in_robot - self.measurement.vector())
    }
}

impl Factor for RelativePosition2 {
    fixed_shape!("RelativePosition2", 2, [Pose2, Point2]);

    #[inline]
    fn residual(&self, at: &Arguments<'_>, out: &mut [f64]) {
        let (_, error) = self.evaluate(&at.get(0), at);
        out.copy_from_slice((self.sqrt_information * error).as_slice());
    }

    #[inline]
    fn linearize(&self, at: &Arguments<'_>, out: &mut Linearization<'_>) {
        let world_from_robot: Pose2 = at.get(0);
        let (q, error) = self.evaluate(&world_from_robot, at);
        let r = &self.sqrt_information;
        out.set_block(0, &(r * Matrix2x3::new(-1.0, 0.0, q.y, 0.0, -1.0, -q.x)));
        out.set_block(1, &(r * world_from_robot.rotation().matrix().transpose()));
        out.set_residual(&(r * error));
    }
}

/// A point in space seen from a pose, by a sensor with an offset: `r = R ((T S)⁻¹ p - z)`.
///
/// `T = world_from_robot`, `S = robot_from_sensor` (fixed, the identity by default), `p` the point
/// in the world, `z` the point in the sensor's frame, metres. With `q = T⁻¹ p`, `C` and `D` the
/// rotations of `T` and `S`:
///
/// ```text
/// J_pose  = R Dᵀ [-I [q]×]        J_point = R Dᵀ Cᵀ
/// ```
#[derive(Clone, Debug)]
pub struct RelativePosition3 {
    keys: [VariableId; 2],
    measurement: Point3,
    robot_from_sensor: Pose3,
    noise: Noise,
    sqrt_information: Matrix3<f64>,
}

impl RelativePosition3 {
    /// `measurement` is the place of `point` in the frame of `pose`.
    ///
    /// # Errors
    /// [`FactorError::NoiseDimension`], [`FactorError::NotFinite`].
    pub fn new(
        pose: Key<Pose3>,
        point: Key<Point3>,
        measurement: Point3,
        noise: Noise,
    ) -> Result<Self, FactorError> {
        Self::with_sensor(pose, point, measurement, Pose3::identity(), noise)
    }

    /// `measurement` is the place of `point` in the frame of a sensor that is fixed at
    /// `robot_from_sensor` on the robot at `pose`.
    ///
    /// # Errors
    /// [`FactorError::NoiseDimension`], [`FactorError::NotFinite`].
    pub fn with_sensor(
        pose: Key<Pose3>,
        point: Key<Point3>,
        measurement: Point3,
        robot_from_sensor: Pose3,
        noise: Noise,
    ) -> Result<Self, FactorError> {
        finite_value("RelativePosition3", "measurement", &measurement)?;
        finite_value("RelativePosition3", "sensor offset", &robot_from_sensor)?;
        let sqrt_information = fixed("RelativePosition3", &noise)?;
        Ok(Self {
            keys: [pose.id(), point.id()],
            measurement,
            robot_from_sensor,
            noise,
            sqrt_information,
        })
    }

    /// The pose that sees.
    pub fn pose(&self) -> VariableId {
        self.keys[0]
    }

    /// The point that is seen.
    pub fn point(&self) -> VariableId {
        self.keys[1]
    }

    /// The point in the sensor's frame.
    pub fn measurement(&self) -> Point3 {
        self.measurement
    }

    /// Where the sensor is mounted.
    pub fn robot_from_sensor(&self) -> &Pose3 {
        &self.robot_from_sensor
    }

    /// The noise.
    pub fn noise(&self) -> &Noise {
        &self.noise
    }

    /// The point in the robot's frame and the unwhitened residual.
    #[inline]
    fn evaluate(
        &self,
        world_from_robot: &Pose3,
        at: &Arguments<'_>,
    ) -> (Vector3<f64>, Vector3<f64>) {
        let in_robot = world_from_robot.inverse_transform_point(&at.get(1));
        let in_sensor = self.robot_from_sensor.inverse_transform_point(&in_robot);
        (in_robot.vector(), in_sensor.vector() - self.measurement.vector())
    }
}

impl Factor for RelativePosition3 {
    fixed_shape!("RelativePosition3", 3, [Pose3, Point3]);

    #[inline]
    fn residual(&self, at: &Arguments<'_>, out: &mut [f64]) {
        let (_, error) = self.evaluate(&at.get(0), at);
        out.copy_from_slice((self.sqrt_information * error).as_slice());
    }

    #[inline]
    fn linearize(&self, at: &Arguments<'_>, out: &mut Linearization<'_>) {
        let world_from_robot: Pose3 = at.get(0);
        let (q, error) = self.evaluate(&world_from_robot, at);
        let turned = self.sqrt_information * self.robot_from_sensor.rotation().matrix().transpose();
        let (position, rotation) = out.block_mut(0).split_at_mut(9);
        position.copy_from_slice((-turned).as_slice());
        rotation.copy_from_slice(times_skew(&turned, &q).as_slice());
        out.set_block(1, &(turned * world_from_robot.rotation().matrix().transpose()));
        out.set_residual(&(self.sqrt_information * error));
    }
}
