//! Types of a user's own in the plane of the library.

use evergraph_model::geometry::wrap_angle;
use evergraph_model::{Frame, Manifold, Motion, Moves, Point2, Pose2};
use nalgebra::Matrix3;

/// A pose in the plane whose tangent is `(x, y, heading)` along the axes of the world, not of the robot.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Place {
    pub x: f64,
    pub y: f64,
    pub heading: f64,
}

/// The rotation of the plane by an angle, on `(x, y, heading)`.
fn turn(angle: f64) -> Matrix3<f64> {
    let (sin, cos) = angle.sin_cos();
    Matrix3::new(cos, -sin, 0.0, sin, cos, 0.0, 0.0, 0.0, 1.0)
}

impl Manifold for Place {
    const NAME: &'static str = "Place";
    const COMPONENTS: &'static [&'static str] = &["x", "y", "heading"];
    const MOTION: Option<Motion> = Some(Motion::of_pose::<Self, Pose2, 3>());
    fn dim(&self) -> usize {
        3
    }
    fn storage_len(&self) -> usize {
        3
    }
    fn store(&self, out: &mut [f64]) {
        out.copy_from_slice(&[self.x, self.y, self.heading]);
    }
    fn load(s: &[f64]) -> Self {
        Self { x: s[0], y: s[1], heading: s[2] }
    }
    fn retract(&self, d: &[f64]) -> Self {
        Self { x: self.x + d[0], y: self.y + d[1], heading: wrap_angle(self.heading + d[2]) }
    }
    fn local(&self, other: &Self, out: &mut [f64]) {
        out.copy_from_slice(&[
            other.x - self.x,
            other.y - self.y,
            wrap_angle(other.heading - self.heading),
        ]);
    }
}

impl Moves<Pose2, 3> for Place {
    const ROTATION: usize = 1;
    fn seen_from(&self, frame: &Pose2) -> Self {
        let place = frame.inverse_transform_point(&Point2::new(self.x, self.y));
        let heading = wrap_angle(self.heading - frame.rotation().angle());
        Self { x: place.x(), y: place.y(), heading }
    }
    fn seen_from_derivative(&self, frame: &Pose2, out: &mut [f64]) {
        out.copy_from_slice(turn(-frame.rotation().angle()).as_slice());
    }
    fn lever(&self, out: &mut [f64]) {
        out.copy_from_slice(&[1.0, 0.0, 0.0, 0.0, 1.0, 0.0, -self.y, self.x, 1.0]);
    }
}

impl Frame<Pose2, 3> for Place {
    fn frame(&self) -> Pose2 {
        Pose2::new(self.x, self.y, self.heading)
    }
    fn frame_derivative(&self, out: &mut [f64]) {
        out.copy_from_slice(turn(-self.heading).as_slice());
    }
}

/// A lamp: a point in the plane, and a height that no motion of the plane changes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lamp {
    pub place: Point2,
    pub height: f64,
}

impl Manifold for Lamp {
    const NAME: &'static str = "Lamp";
    const COMPONENTS: &'static [&'static str] = &["x", "y", "height"];
    const MOTION: Option<Motion> = Some(Motion::of::<Self, Pose2, 3>());
    fn dim(&self) -> usize {
        3
    }
    fn storage_len(&self) -> usize {
        3
    }
    fn store(&self, out: &mut [f64]) {
        out.copy_from_slice(&[self.place.x(), self.place.y(), self.height]);
    }
    fn load(s: &[f64]) -> Self {
        Self { place: Point2::new(s[0], s[1]), height: s[2] }
    }
    fn retract(&self, d: &[f64]) -> Self {
        Self { place: self.place.retract(&d[..2]), height: self.height + d[2] }
    }
    fn local(&self, other: &Self, out: &mut [f64]) {
        self.place.local(&other.place, &mut out[..2]);
        out[2] = other.height - self.height;
    }
}

impl Moves<Pose2, 3> for Lamp {
    const ROTATION: usize = 0;
    fn seen_from(&self, frame: &Pose2) -> Self {
        Self { place: frame.inverse_transform_point(&self.place), ..*self }
    }
    fn seen_from_derivative(&self, frame: &Pose2, out: &mut [f64]) {
        out.copy_from_slice(turn(-frame.rotation().angle()).as_slice());
    }
    fn lever(&self, out: &mut [f64]) {
        let (x, y) = (self.place.x(), self.place.y());
        out.copy_from_slice(&[1.0, 0.0, 0.0, 0.0, 1.0, 0.0, -y, x, 0.0]);
    }
}
