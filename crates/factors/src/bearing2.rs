//! Bearings in the plane, alone and with a range.

use std::marker::PhantomData;

use evergraph_model::{
    Arguments, Factor, Key, Linearization, Noise, Pose2, VariableId, geometry::wrap_angle,
};
use nalgebra::{Matrix1, Matrix2, RowVector2, SMatrix, SVector, Vector1, Vector2};

use crate::error::{FactorError, distance, finite, fixed, fixed_shape};
use crate::positioned::{Positioned, polar};

/// The bearing of something in the plane: `r = R wrap(atan2(q_y, q_x) - z)`, radians.
///
/// `q = Cᵀ (p - t)` is the target's position `p` in the frame of the pose with rotation `C` and
/// translation `t`; `z` is measured from the pose's x axis towards its y axis. With `ρ = |q|`:
///
/// ```text
/// J_q = R (-q_y, q_x)/ρ²       J_pose = J_q [-1 0 q_y; 0 -1 -q_x]       J_target = J_q Cᵀ ∂p/∂ξ
/// ```
///
/// The Jacobian grows without bound towards the target. A pose on its target sees it nowhere: the
/// bearing is taken as straight ahead there, and the Jacobian as zero.
#[derive(Clone, Debug)]
pub struct Bearing2<B> {
    keys: [VariableId; 2],
    measurement: f64,
    noise: Noise,
    sqrt_information: Matrix1<f64>,
    kind: PhantomData<fn() -> B>,
}

/// Bearing and range of something in the plane:
/// `r = R (wrap(atan2(q_y, q_x) - z_b), |q| - z_r)`, radians and metres.
///
/// Each row as in [`Bearing2`] and [`Range`](crate::Range); one factor, so that their noise may be
/// correlated.
#[derive(Clone, Debug)]
pub struct BearingRange2<B> {
    keys: [VariableId; 2],
    bearing: f64,
    range: f64,
    noise: Noise,
    sqrt_information: Matrix2<f64>,
    kind: PhantomData<fn() -> B>,
}

impl<B: Positioned<2>> Bearing2<B> {
    /// `bearing` is the direction of `target` in the frame of `pose`, radians; the noise has one
    /// dimension.
    ///
    /// # Errors
    /// [`FactorError::NoiseDimension`], [`FactorError::NotFinite`].
    pub fn new(
        pose: Key<Pose2>,
        target: Key<B>,
        bearing: f64,
        noise: Noise,
    ) -> Result<Self, FactorError> {
        finite("Bearing2", "bearing", &[bearing])?;
        let sqrt_information = fixed("Bearing2", &noise)?;
        let keys = [pose.id(), target.id()];
        Ok(Self { keys, measurement: bearing, noise, sqrt_information, kind: PhantomData })
    }

    #[inline]
    fn error(&self, sight: &Sight) -> Vector1<f64> {
        Vector1::new(wrap_angle(sight.bearing() - self.measurement))
    }
}

impl<B: Positioned<2>> BearingRange2<B> {
    /// `bearing` is the direction of `target` in the frame of `pose`, radians, `range` its
    /// distance, metres; the noise has two dimensions in that order.
    ///
    /// # Errors
    /// [`FactorError::NegativeRange`], [`FactorError::NoiseDimension`], [`FactorError::NotFinite`].
    pub fn new(
        pose: Key<Pose2>,
        target: Key<B>,
        bearing: f64,
        range: f64,
        noise: Noise,
    ) -> Result<Self, FactorError> {
        finite("BearingRange2", "bearing", &[bearing])?;
        let range = distance("BearingRange2", range)?;
        let sqrt_information = fixed("BearingRange2", &noise)?;
        let keys = [pose.id(), target.id()];
        Ok(Self { keys, bearing, range, noise, sqrt_information, kind: PhantomData })
    }

    #[inline]
    fn error(&self, sight: &Sight) -> Vector2<f64> {
        Vector2::new(wrap_angle(sight.bearing() - self.bearing), sight.range - self.range)
    }
}

impl<B> Bearing2<B> {
    /// The pose that sees.
    pub fn pose(&self) -> VariableId {
        self.keys[0]
    }

    /// What is seen.
    pub fn target(&self) -> VariableId {
        self.keys[1]
    }

    /// The measured bearing, in radians.
    pub fn measurement(&self) -> f64 {
        self.measurement
    }

    /// The noise.
    pub fn noise(&self) -> &Noise {
        &self.noise
    }
}

impl<B> BearingRange2<B> {
    /// The pose that sees.
    pub fn pose(&self) -> VariableId {
        self.keys[0]
    }

    /// What is seen.
    pub fn target(&self) -> VariableId {
        self.keys[1]
    }

    /// The measured bearing, in radians.
    pub fn bearing(&self) -> f64 {
        self.bearing
    }

    /// The measured distance, in metres.
    pub fn range(&self) -> f64 {
        self.range
    }

    /// The noise of bearing and range.
    pub fn noise(&self) -> &Noise {
        &self.noise
    }
}

impl<B: Positioned<2>> Factor for Bearing2<B> {
    fixed_shape!(format!("Bearing2<{}>", B::NAME), 1, [Pose2, B]);

    fn residual(&self, at: &Arguments<'_>, out: &mut [f64]) {
        let sight = Sight::new(&at.get(0), &at.get::<B>(1));
        out.copy_from_slice((self.sqrt_information * self.error(&sight)).as_slice());
    }

    fn linearize(&self, at: &Arguments<'_>, out: &mut Linearization<'_>) {
        let (pose, target): (Pose2, B) = (at.get(0), at.get(1));
        let sight = Sight::new(&pose, &target);
        if let Some((by_bearing, _)) = sight.derivatives() {
            sight.set_blocks(&pose, &target, &(self.sqrt_information * by_bearing), out);
        }
        out.set_residual(&(self.sqrt_information * self.error(&sight)));
    }
}

impl<B: Positioned<2>> Factor for BearingRange2<B> {
    fixed_shape!(format!("BearingRange2<{}>", B::NAME), 2, [Pose2, B]);

    fn residual(&self, at: &Arguments<'_>, out: &mut [f64]) {
        let sight = Sight::new(&at.get(0), &at.get::<B>(1));
        out.copy_from_slice((self.sqrt_information * self.error(&sight)).as_slice());
    }

    fn linearize(&self, at: &Arguments<'_>, out: &mut Linearization<'_>) {
        let (pose, target): (Pose2, B) = (at.get(0), at.get(1));
        let sight = Sight::new(&pose, &target);
        if let Some((by_bearing, by_range)) = sight.derivatives() {
            let by_place = Matrix2::from_rows(&[by_bearing, by_range]);
            sight.set_blocks(&pose, &target, &(self.sqrt_information * by_place), out);
        }
        out.set_residual(&(self.sqrt_information * self.error(&sight)));
    }
}

/// A target as a pose sees it.
struct Sight {
    /// `q`.
    place: SVector<f64, 2>,
    range: f64,
    /// `q/ρ`, where there is one.
    direction: Option<Vector2<f64>>,
}

impl Sight {
    #[inline]
    fn new<B: Positioned<2>>(pose: &Pose2, target: &B) -> Self {
        let place = pose.rotation().inverse_rotate(&(target.position() - pose.position()));
        let (range, direction) = polar(&place);
        Self { place, range, direction }
    }

    #[inline]
    fn bearing(&self) -> f64 {
        self.direction.map_or(0.0, |direction| direction.y.atan2(direction.x))
    }

    /// Of bearing and range by `q`.
    #[inline]
    fn derivatives(&self) -> Option<(RowVector2<f64>, RowVector2<f64>)> {
        let u = self.direction?;
        Some((RowVector2::new(-u.y, u.x) / self.range, u.transpose()))
    }

    /// Both blocks, from the whitened derivative by `q`.
    #[inline]
    fn set_blocks<B: Positioned<2>, const R: usize>(
        &self,
        pose: &Pose2,
        target: &B,
        by_place: &SMatrix<f64, R, 2>,
        out: &mut Linearization<'_>,
    ) {
        let q = self.place;
        out.set_block(0, &(by_place * SMatrix::<f64, 2, 3>::new(-1.0, 0.0, q.y, 0.0, -1.0, -q.x)));
        target.chain(&(by_place * pose.rotation().matrix().transpose()), out.block_mut(1));
    }
}
