//! From latitude and longitude to metres in the world's frame, and back.

use evergraph_model::{Point3, geometry::wrap_angle};
use nalgebra::{Matrix3, Vector3};
use serde::{Deserialize, Serialize};
use thiserror::Error;

/// Semi-major axis of WGS 84 in metres (defining).
const A: f64 = 6_378_137.0;
/// Flattening of WGS 84 (defining).
const F: f64 = 1.0 / 298.257_223_563;
/// Semi-minor axis.
const B: f64 = A * (1.0 - F);
/// First eccentricity, squared: `(a² - b²)/a²`.
const E2: f64 = F * (2.0 - F);
/// Second eccentricity, squared: `(a² - b²)/b²`.
const EP2: f64 = E2 / (1.0 - E2);

/// A position on the earth, on the WGS 84 ellipsoid as GPS receivers give it.
///
/// Plain numbers; [`check`](Self::check) says whether they are a position.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Geodetic {
    /// Geodetic latitude, radians north, in [-π/2, π/2].
    pub latitude: f64,
    /// Longitude, radians east, in [-2π, 2π]: counted from -180° or from 0°.
    pub longitude: f64,
    /// Height above the ellipsoid (not above sea level), metres.
    pub height: f64,
}

/// Why numbers are no position on the earth.
#[derive(Clone, Debug, PartialEq, Error)]
#[non_exhaustive]
pub enum GeodeticError {
    /// A NaN or an infinity.
    #[error("the {what} of a geodetic position must be finite, got {value}")]
    NotFinite {
        /// Which number.
        what: &'static str,
        /// The number given.
        value: f64,
    },
    /// An angle that is none.
    #[error(
        "a {what} of {radians} rad is beyond {limit} degrees; are degrees given as radians, or \
         latitude and longitude swapped?"
    )]
    OutOfRange {
        /// Which angle.
        what: &'static str,
        /// The angle given.
        radians: f64,
        /// The largest that there is.
        limit: f64,
    },
}

impl Geodetic {
    /// From latitude (north) and longitude (east) in degrees and the height in metres.
    pub fn from_degrees(latitude: f64, longitude: f64, height: f64) -> Self {
        Self { latitude: latitude.to_radians(), longitude: longitude.to_radians(), height }
    }

    /// Latitude and longitude in degrees.
    pub fn degrees(&self) -> (f64, f64) {
        (self.latitude.to_degrees(), self.longitude.to_degrees())
    }

    /// Whether the numbers are a position.
    ///
    /// # Errors
    /// [`GeodeticError`].
    pub fn check(&self) -> Result<(), GeodeticError> {
        let Self { latitude, longitude, height } = *self;
        for (what, value) in [("latitude", latitude), ("longitude", longitude), ("height", height)]
        {
            if !value.is_finite() {
                return Err(GeodeticError::NotFinite { what, value });
            }
        }
        for (what, radians, limit) in
            [("latitude", latitude, 90.0), ("longitude", longitude, 360.0)]
        {
            if radians.abs() > f64::to_radians(limit) {
                return Err(GeodeticError::OutOfRange { what, radians, limit });
            }
        }
        Ok(())
    }

    /// Earth-centred, earth-fixed coordinates: x towards (0° N, 0° E), y towards (0° N, 90° E), z
    /// towards the north pole, metres.
    fn to_earth_centred(self) -> Vector3<f64> {
        let ((sin, cos), (sin_lon, cos_lon)) = (self.latitude.sin_cos(), self.longitude.sin_cos());
        // Radius of curvature across the meridian.
        let n = A / (1.0 - E2 * sin * sin).sqrt();
        let from_axis = (n + self.height) * cos;
        Vector3::new(from_axis * cos_lon, from_axis * sin_lon, ((1.0 - E2) * n + self.height) * sin)
    }

    /// Bowring's iteration on the reduced latitude `β`,
    ///
    /// ```text
    /// tan φ = (z + e'² b sin³ β)/(p - e² a cos³ β)      tan β = (1 - f) tan φ
    /// ```
    ///
    /// from the `β` of a point on the surface. The error shrinks by three orders of magnitude or
    /// more each time for any height above -1000 km. Within 43 km of the earth's centre normals of
    /// the ellipsoid cross, and a point has several latitudes.
    fn from_earth_centred(position: &Vector3<f64>) -> Self {
        const ITERATIONS: usize = 6;
        let (p, z) = (position.x.hypot(position.y), position.z);
        let (mut sin, mut cos) = unit(z, (1.0 - F) * p);
        for _ in 0..ITERATIONS {
            let (sin_beta, cos_beta) = unit((1.0 - F) * sin, cos);
            (sin, cos) = unit(z + EP2 * B * sin_beta.powi(3), p - E2 * A * cos_beta.powi(3));
        }
        Self {
            latitude: sin.atan2(cos),
            longitude: wrap_angle(position.y.atan2(position.x)),
            // Without dividing by either function, one of which is zero at the equator or a pole.
            height: p * cos + z * sin - A * (1.0 - E2 * sin * sin).sqrt(),
        }
    }
}

/// Sine and cosine of the angle of `(y, x)`.
fn unit(y: f64, x: f64) -> (f64, f64) {
    let norm = x.hypot(y);
    if norm == 0.0 { (0.0, 1.0) } else { (y / norm, x / norm) }
}

/// A frame on the earth: x east, y north, z up at an origin, metres.
///
/// Straight axes, fixed to the earth: the ground curves away below them, 8 cm at a kilometre and
/// 8 m at ten. Made for the world frame of a map, where GPS fixes become positions:
///
/// ```
/// use evergraph_factors::{Geodetic, GpsPosition3, LocalFrame};
/// use evergraph_model::{Graph, Noise, Pose3, Rot3};
///
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// let frame = LocalFrame::new(Geodetic::from_degrees(42.293_2, -83.710_1, 270.0))?;
///
/// let graph = Graph::new();
/// let mut change = graph.change();
/// let pose = change.add_variable(&Pose3::new(Rot3::from_roll_pitch_yaw(0.0, 0.0, 0.3), [0.0; 3]));
///
/// let fix = Geodetic::from_degrees(42.293_3, -83.710_0, 270.4);
/// let position = frame.to_local(fix); // 8.2 m east, 11.1 m north, 0.4 m up
/// let noise = Noise::from_sigmas(&[3.0, 3.0, 10.0])?;
/// change.add_factor(GpsPosition3::new(pose, position, noise)?);
///
/// assert!((position.y() - 11.1).abs() < 0.05);
/// let back = frame.to_geodetic(position);
/// assert!((back.latitude - fix.latitude).abs() < 1e-14);
/// # Ok(())
/// # }
/// ```
///
/// Formulas: EPSG Guidance Note 7-2, sections "Geographic/Geocentric conversions" and
/// "Geographic/Topocentric conversions"; the way back after Bowring, "Transformation from spatial
/// to geographical coordinates" (1976), iterated to the last digit.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "Geodetic", into = "Geodetic")]
pub struct LocalFrame {
    origin: Geodetic,
    /// The origin in earth-centred coordinates.
    centre: Vector3<f64>,
    earth_from_local: Matrix3<f64>,
}

impl LocalFrame {
    /// The frame at `origin`. At a pole, east and north are those of the origin's longitude.
    ///
    /// # Errors
    /// [`GeodeticError`] when `origin` is no position.
    pub fn new(origin: Geodetic) -> Result<Self, GeodeticError> {
        origin.check()?;
        let (sin, cos) = origin.latitude.sin_cos();
        let (sin_lon, cos_lon) = origin.longitude.sin_cos();
        let east = Vector3::new(-sin_lon, cos_lon, 0.0);
        let north = Vector3::new(-sin * cos_lon, -sin * sin_lon, cos);
        let up = Vector3::new(cos * cos_lon, cos * sin_lon, sin);
        let earth_from_local = Matrix3::from_columns(&[east, north, up]);
        Ok(Self { origin, centre: origin.to_earth_centred(), earth_from_local })
    }

    /// The position in this frame, good to some nanometres. All coordinates are NaN when the
    /// numbers are no position ([`Geodetic::check`]); every factor refuses such a measurement.
    pub fn to_local(&self, position: Geodetic) -> Point3 {
        if position.check().is_err() {
            return Point3::new(f64::NAN, f64::NAN, f64::NAN);
        }
        self.earth_from_local.tr_mul(&(position.to_earth_centred() - self.centre)).into()
    }

    /// The inverse of [`to_local`](Self::to_local), with the longitude in (-π, π]. Not finite where
    /// the point is not. Good to some nanometres from 5000 km below ground upwards.
    pub fn to_geodetic(&self, point: Point3) -> Geodetic {
        Geodetic::from_earth_centred(&(self.earth_from_local * point.vector() + self.centre))
    }

    /// Where the frame is.
    pub fn origin(&self) -> Geodetic {
        self.origin
    }
}

impl TryFrom<Geodetic> for LocalFrame {
    type Error = GeodeticError;

    fn try_from(origin: Geodetic) -> Result<Self, GeodeticError> {
        Self::new(origin)
    }
}

impl From<LocalFrame> for Geodetic {
    fn from(frame: LocalFrame) -> Self {
        frame.origin
    }
}
