//! The coordinates that a linear factor is linear in.

use evergraph_model::{
    LieGroup, Manifold, Motion, Point2, Point3, Pose2, Pose3, Rot2, Rot3, Value, VariableType,
    VectorN,
};
use nalgebra::{DMatrix, DMatrixView, SMatrix, SVector};
use serde::{Deserialize, Serialize};
use smallvec::SmallVec;

use crate::error::FactorError;
use crate::prior::LocalJacobian;

/// How the variables of a [`Linear`](crate::Linear) factor are seen before it is linear in them.
///
/// A good linearization point for where poses stand to each other is known long before one for
/// where they stand in the world (section II-C of the GLC paper). With a shift the first variable,
/// a pose, is the root; every other pose of the root's type and every point of its world is seen from
/// it; variables of other kinds stay as they are.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum RootShift {
    /// `(x₁, x₂, …)`: linear in the world frame.
    None,
    /// `(x₁, x₁⁻¹ x₂, …)`. For a pair of poses the derivative is `[I 0; -Ad((x₁⁻¹ x₂)⁻¹) I]`: nothing
    /// of the size of the world enters. For a point `p`, `c = x₁⁻¹ p = C₁ᵀ (p - t₁)` and the derivative
    /// is `[-[I -[c]×]  C₁ᵀ]` (in the plane `[-[I J c]  C₁ᵀ]`, J the quarter turn).
    Root,
    /// `(x₁⁻¹, x₁⁻¹ x₂, …)`: equation 5 of the paper. The same information as [`Root`](Self::Root)
    /// at the linearization point, with entries that grow with the distance to the origin.
    InverseRoot,
}

impl RootShift {
    /// The derivative of the coordinates by the variables, right perturbations on both sides: the
    /// `R` of equation 6, square and invertible, so that `Λ' = R⁻ᵀ Λ R⁻¹`.
    ///
    /// # Errors
    /// [`FactorError::RootIsNoPose`].
    pub fn jacobian(self, points: &[Value]) -> Result<DMatrix<f64>, FactorError> {
        let (charts, coordinates) = coordinates(self, points)?;
        let width = points.iter().map(Value::dim).sum();
        let mut jacobian = DMatrix::zeros(width, width);
        let mut row = 0;
        for ((chart, coordinate), point) in charts.iter().zip(&coordinates).zip(points) {
            let (n, of_root) = (point.dim(), points[0].dim());
            let mut own = DMatrix::<f64>::identity(n, n);
            if chart.follows_the_root() {
                let mut by_root = DMatrix::zeros(n, of_root);
                let root = points[0].storage();
                chart.transport(root, coordinate.storage(), own.as_slice(), by_root.as_mut_slice());
                jacobian.view_mut((row, 0), (n, of_root)).copy_from(&-by_root);
            }
            if chart.follows_its_variable() {
                chart.turn(points[0].storage(), point.storage(), own.as_mut_slice());
                jacobian.view_mut((row, row), (n, n)).copy_from(&own);
            }
            row += n;
        }
        Ok(jacobian)
    }

    /// Whether a variable that is not the first is seen from the first.
    pub fn sees(self, root: &VariableType, kind: &VariableType) -> bool {
        self != Self::None && is_seen(root, kind)
    }

    /// The coordinates `r(x)` at `points`.
    ///
    /// # Errors
    /// [`FactorError::RootIsNoPose`].
    pub fn coordinates(self, points: &[Value]) -> Result<Vec<Value>, FactorError> {
        coordinates(self, points).map(|(_, coordinates)| coordinates)
    }
}

/// The charts of a factor's variables, and the coordinates at `points`.
pub(crate) fn coordinates(
    shift: RootShift,
    points: &[Value],
) -> Result<(Vec<Chart>, Vec<Value>), FactorError> {
    if shift != RootShift::None
        && let Some(root) = points.first()
        && pose(root.kind()).is_none_or(|motion| motion.world().dim() != root.dim())
    {
        return Err(FactorError::RootIsNoPose { actual: root.kind().name() });
    }
    let charts: Vec<Chart> = points
        .iter()
        .enumerate()
        .map(|(k, point)| Chart::of(shift, k, &points[0], point))
        .collect();
    let coordinates =
        charts.iter().zip(points).map(|(chart, point)| chart.value(&points[0], point)).collect();
    Ok((charts, coordinates))
}

/// The motion of a type that is a pose.
fn pose(kind: &'static VariableType) -> Option<&'static Motion> {
    kind.motion().filter(|motion| motion.is_pose())
}

/// Whether a pose of type `root` sees variables of type `kind`.
fn is_seen(root: &VariableType, kind: &VariableType) -> bool {
    root.motion().zip(kind.motion()).is_some_and(|(root, motion)| {
        root.is_pose() && motion.is_seen() && root.world() == motion.world()
    })
}

/// The map from one variable to one coordinate.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Chart {
    seen: Seen,
    group: Group,
    /// The motions of the root and of the variable, where one of them is of a user's type.
    users: Option<(&'static Motion, &'static Motion)>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Seen {
    AsItIs,
    /// `x₁⁻¹`, of the root itself.
    Inverted,
    /// `x₁⁻¹ xₖ`.
    FromTheRoot,
}

/// The stored numbers of a coordinate.
pub(crate) type Buffer = SmallVec<[f64; 7]>;

/// A [`VariableType`] resolved once, so that the hot path compares no type ids.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Group {
    Pose2,
    Pose3,
    Rot3,
    Point2,
    Point3,
    /// Vectors and angles: as for points, the derivative of `Local` is the identity.
    Flat,
    /// A type from outside this library.
    Other,
}

impl Group {
    fn of(kind: &VariableType) -> Self {
        if kind.is::<Pose2>() {
            Self::Pose2
        } else if kind.is::<Pose3>() {
            Self::Pose3
        } else if kind.is::<Rot3>() {
            Self::Rot3
        } else if kind.is::<Point2>() {
            Self::Point2
        } else if kind.is::<Point3>() {
            Self::Point3
        } else if kind.is::<Rot2>() || kind.is::<VectorN>() {
            Self::Flat
        } else {
            Self::Other
        }
    }
}

impl Chart {
    /// The chart of variable `k`, at `point`.
    fn of(shift: RootShift, k: usize, root: &Value, point: &Value) -> Self {
        let kind = point.kind();
        let seen = match (shift, k) {
            (RootShift::None, _) | (RootShift::Root, 0) => Seen::AsItIs,
            (RootShift::InverseRoot, 0) => Seen::Inverted,
            _ if is_seen(root.kind(), kind) => Seen::FromTheRoot,
            _ => Seen::AsItIs,
        };
        let (of_root, group) = (Group::of(root.kind()), Group::of(kind));
        let are_ours = |group| matches!(group, Group::Pose2 | Group::Pose3);
        let is_erased = seen != Seen::AsItIs && !(are_ours(of_root) && group != Group::Other);
        let users = root.kind().motion().zip(kind.motion()).filter(|_| is_erased);
        Self { seen, group, users }
    }

    pub(crate) fn follows_its_variable(&self) -> bool {
        self.seen != Seen::Inverted
    }

    pub(crate) fn follows_the_root(&self) -> bool {
        self.seen != Seen::AsItIs
    }

    /// The coordinate of a stored `point`, in `buffer` unless it is the point itself.
    #[inline]
    pub(crate) fn coordinate<'b>(
        &self,
        root: &[f64],
        point: &'b [f64],
        buffer: &'b mut Buffer,
    ) -> &'b [f64] {
        if self.seen == Seen::AsItIs {
            return point;
        }
        if let Some(users) = self.users {
            return self.coordinate_of_users(users, root, point, buffer);
        }
        buffer.resize(point.len(), 0.0);
        let out = &mut buffer[..];
        match (self.seen, self.group) {
            (Seen::FromTheRoot, Group::Pose2) => {
                Pose2::load(root).between(&Pose2::load(point)).store(out)
            }
            (Seen::FromTheRoot, Group::Pose3) => {
                Pose3::load(root).between(&Pose3::load(point)).store(out)
            }
            (Seen::FromTheRoot, Group::Point2) => {
                Pose2::load(root).inverse_transform_point(&Point2::load(point)).store(out)
            }
            (Seen::FromTheRoot, Group::Point3) => {
                Pose3::load(root).inverse_transform_point(&Point3::load(point)).store(out)
            }
            (Seen::Inverted, Group::Pose2) => Pose2::load(point).inverse().store(out),
            (Seen::Inverted, Group::Pose3) => Pose3::load(point).inverse().store(out),
            _ => return point,
        }
        out
    }

    /// [`coordinate`](Self::coordinate) where the root or the variable is of a user's type.
    fn coordinate_of_users<'b>(
        &self,
        (of_root, motion): (&Motion, &Motion),
        root: &[f64],
        point: &'b [f64],
        buffer: &'b mut Buffer,
    ) -> &'b [f64] {
        buffer.resize(point.len(), 0.0);
        match (self.seen, of_root.frame(root)) {
            (Seen::Inverted, Some(_)) => {
                motion.inverted(point, buffer);
            }
            (_, Some(frame)) => motion.seen_from(point, &frame, buffer),
            (_, None) => return point,
        }
        buffer
    }

    fn value(&self, root: &Value, point: &Value) -> Value {
        let mut buffer = Buffer::new();
        point.with_storage(self.coordinate(root.storage(), point.storage(), &mut buffer))
    }

    /// The derivative of `local(base, c)` by a right perturbation of `c`, where `local` is its
    /// value; column-major into `out`, which is zero.
    pub(crate) fn local_jacobian(&self, base: &Value, c: &[f64], local: &[f64], out: &mut [f64]) {
        match self.group {
            Group::Pose2 => Pose2::load(base.storage()).local_jacobian(local, out),
            Group::Pose3 => Pose3::load(base.storage()).local_jacobian(local, out),
            Group::Rot3 => Rot3::load(base.storage()).local_jacobian(local, out),
            Group::Point2 | Group::Point3 | Group::Flat => {
                (0..local.len()).for_each(|i| out[i * (local.len() + 1)] = 1.0)
            }
            Group::Other => numeric_local_jacobian(base, c, out),
        }
    }

    /// From the derivative `m` by the coordinate to minus that by the root: `m Ad(c⁻¹)` for a pose,
    /// `m [I -[c]×]` (in the plane `m [I J c]`) for a point.
    pub(crate) fn transport(&self, root: &[f64], c: &[f64], m: &[f64], out: &mut [f64]) {
        if let Some((of_root, motion)) = self.users {
            transport_of_users(of_root, motion, root, c, m, out);
            return;
        }
        match self.group {
            Group::Pose2 => times_adjoint_of_inverse(&Pose2::load(c), m, out),
            Group::Pose3 => times_adjoint_of_inverse(&Pose3::load(c), m, out),
            Group::Point2 => {
                let lever = SMatrix::<f64, 2, 3>::new(1.0, 0.0, -c[1], 0.0, 1.0, c[0]);
                let product = SMatrix::<f64, 2, 2>::from_column_slice(m) * lever;
                out.copy_from_slice(product.as_slice());
            }
            Group::Point3 => {
                let mut lever = SMatrix::<f64, 3, 6>::identity();
                let cross = SVector::<f64, 3>::from_column_slice(c).cross_matrix();
                lever.fixed_view_mut::<3, 3>(0, 3).copy_from(&-cross);
                let product = SMatrix::<f64, 3, 3>::from_column_slice(m) * lever;
                out.copy_from_slice(product.as_slice());
            }
            _ => unreachable!("only poses and points are shifted"),
        }
    }

    /// From the derivative by the coordinate to that by the variable itself, in place: `m C₁ᵀ` for a
    /// point that is seen from the root, `m` for all else.
    pub(crate) fn turn(&self, root: &[f64], point: &[f64], m: &mut [f64]) {
        if let (Seen::FromTheRoot, Some((of_root, motion))) = (self.seen, self.users) {
            turn_of_users(of_root, motion, root, point, m);
            return;
        }
        match (self.seen, self.group) {
            (Seen::FromTheRoot, Group::Point2) => {
                let turn = Pose2::load(root).rotation();
                let (cos, sin) = (turn.cos(), turn.sin());
                let product = SMatrix::<f64, 2, 2>::from_column_slice(m)
                    * SMatrix::<f64, 2, 2>::new(cos, sin, -sin, cos);
                m.copy_from_slice(product.as_slice());
            }
            (Seen::FromTheRoot, Group::Point3) => {
                let turn = Pose3::load(root).rotation().matrix();
                let product = SMatrix::<f64, 3, 3>::from_column_slice(m) * turn.transpose();
                m.copy_from_slice(product.as_slice());
            }
            _ => {}
        }
    }
}

/// `m L(c) F`, with L the motion of the coordinate with its world and F the derivative of the root's frame.
fn transport_of_users(
    of_root: &Motion,
    motion: &Motion,
    root: &[f64],
    c: &[f64],
    m: &[f64],
    out: &mut [f64],
) {
    let n = of_root.world().dim();
    let dim = out.len() / n.max(1);
    let mut lever = DMatrix::zeros(dim, n);
    motion.lever(c, lever.as_mut_slice());
    if !of_root.is_the_group() {
        let mut frame = DMatrix::zeros(n, n);
        of_root.frame_derivative(root, frame.as_mut_slice());
        lever *= frame;
    }
    out.copy_from_slice((DMatrixView::from_slice(m, dim, dim) * lever).as_slice());
}

/// `m D`, with D the derivative of the coordinate by its variable.
fn turn_of_users(of_root: &Motion, motion: &Motion, root: &[f64], point: &[f64], m: &mut [f64]) {
    let Some(frame) = of_root.frame(root) else { return };
    // `m` is square: a row and a column for each tangent component.
    let dim = m.len().isqrt();
    let mut derivative = DMatrix::zeros(dim, dim);
    motion.seen_from_derivative(point, &frame, derivative.as_mut_slice());
    let product = DMatrixView::from_slice(m, dim, dim) * derivative;
    m.copy_from_slice(product.as_slice());
}

fn times_adjoint_of_inverse<G: LieGroup<N>, const N: usize>(c: &G, m: &[f64], out: &mut [f64]) {
    let product = SMatrix::<f64, N, N>::from_column_slice(m) * c.inverse().adjoint();
    out.copy_from_slice(product.as_slice());
}

/// Five-point central differences, good to about 1e-12: for types that tell no derivative.
fn numeric_local_jacobian(base: &Value, c: &[f64], out: &mut [f64]) {
    const STEP: f64 = 1e-3;
    let (n, kind) = (base.dim(), base.kind());
    let mut delta = vec![0.0; n];
    let (mut moved, mut local) = (vec![0.0; c.len()], vec![0.0; n]);
    for (column, out) in out.chunks_exact_mut(n).enumerate() {
        for (step, weight) in [(1.0, 8.0), (-1.0, -8.0), (2.0, -1.0), (-2.0, 1.0)] {
            delta[column] = step * STEP;
            kind.retract(c, &delta, &mut moved);
            kind.local(base.storage(), &moved, &mut local);
            out.iter_mut().zip(&local).for_each(|(out, l)| *out += weight / (12.0 * STEP) * l);
        }
        delta[column] = 0.0;
    }
}
