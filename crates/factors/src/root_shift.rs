//! The coordinates that a linear factor is linear in.

use evergraph_model::{
    LieGroup, Manifold, Point2, Point3, Pose2, Pose3, Rot2, Rot3, Value, VariableType, VectorN,
};
use nalgebra::{DMatrix, SMatrix};
use serde::{Deserialize, Serialize};

use crate::error::FactorError;
use crate::prior::LocalJacobian;

/// How the variables of a [`Linear`](crate::Linear) factor are seen before it is linear in them.
///
/// A good linearization point for where poses stand to each other is known long before one for
/// where they stand in the world (section II-C of the GLC paper). With a shift the first variable,
/// a pose, is the root; every other pose of the root's type is seen from it; variables of other
/// kinds stay as they are.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum RootShift {
    /// `(x₁, x₂, …)`: linear in the world frame.
    None,
    /// `(x₁, x₁⁻¹ x₂, …)`. For a pair the derivative is `[I 0; -Ad((x₁⁻¹ x₂)⁻¹) I]`: nothing of the
    /// size of the world enters.
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
            let n = point.dim();
            let identity = DMatrix::<f64>::identity(n, n);
            if chart.follows_its_variable() {
                jacobian.view_mut((row, row), (n, n)).copy_from(&identity);
            }
            if chart.follows_the_root() {
                let mut by_root = DMatrix::zeros(n, n);
                chart.transport(coordinate.storage(), identity.as_slice(), by_root.as_mut_slice());
                jacobian.view_mut((row, 0), (n, n)).copy_from(&-by_root);
            }
            row += n;
        }
        Ok(jacobian)
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
    let chart = |k: usize, point: &Value| {
        let kind = point.kind();
        let seen = match (shift, k) {
            (RootShift::None, _) | (RootShift::Root, 0) => Seen::AsItIs,
            (RootShift::InverseRoot, 0) => Seen::Inverted,
            _ if kind == points[0].kind() => Seen::FromTheRoot,
            _ => Seen::AsItIs,
        };
        Chart { seen, group: Group::of(kind) }
    };
    let charts: Vec<Chart> = points.iter().enumerate().map(|(k, point)| chart(k, point)).collect();
    if shift != RootShift::None
        && let Some(root) = points.first()
        && !matches!(charts[0].group, Group::Pose2 | Group::Pose3)
    {
        return Err(FactorError::RootIsNoPose { actual: root.kind().name() });
    }
    let coordinates =
        charts.iter().zip(points).map(|(chart, point)| chart.value(&points[0], point)).collect();
    Ok((charts, coordinates))
}

/// How one variable becomes one coordinate.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Chart {
    seen: Seen,
    group: Group,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Seen {
    AsItIs,
    /// `x₁⁻¹`, of the root itself.
    Inverted,
    /// `x₁⁻¹ xₖ`.
    FromTheRoot,
}

/// A [`VariableType`] resolved once, so that the hot path compares no type ids.
#[derive(Clone, Copy, Debug)]
enum Group {
    Pose2,
    Pose3,
    Rot3,
    /// Points, vectors, angles: the derivative of `Local` is the identity.
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
        } else if kind.is::<Point2>()
            || kind.is::<Point3>()
            || kind.is::<Rot2>()
            || kind.is::<VectorN>()
        {
            Self::Flat
        } else {
            Self::Other
        }
    }
}

impl Chart {
    pub(crate) fn follows_its_variable(&self) -> bool {
        self.seen != Seen::Inverted
    }

    pub(crate) fn follows_the_root(&self) -> bool {
        self.seen != Seen::AsItIs
    }

    /// The coordinate of a stored `point`, in `buffer` unless it is the point itself.
    pub(crate) fn coordinate<'b>(
        &self,
        root: &[f64],
        point: &'b [f64],
        buffer: &'b mut [f64; 7],
    ) -> &'b [f64] {
        let out = &mut buffer[..point.len()];
        match (self.seen, self.group) {
            (Seen::FromTheRoot, Group::Pose2) => {
                Pose2::load(root).between(&Pose2::load(point)).store(out)
            }
            (Seen::FromTheRoot, Group::Pose3) => {
                Pose3::load(root).between(&Pose3::load(point)).store(out)
            }
            (Seen::Inverted, Group::Pose2) => Pose2::load(point).inverse().store(out),
            (Seen::Inverted, Group::Pose3) => Pose3::load(point).inverse().store(out),
            _ => return point,
        }
        out
    }

    fn value(&self, root: &Value, point: &Value) -> Value {
        let mut buffer = [0.0; 7];
        if self.seen == Seen::AsItIs {
            return point.clone();
        }
        let coordinate = self.coordinate(root.storage(), point.storage(), &mut buffer);
        match self.group {
            Group::Pose2 => Value::new(&Pose2::load(coordinate)),
            Group::Pose3 => Value::new(&Pose3::load(coordinate)),
            // The root is a pose, and only what has its type is seen from it.
            _ => unreachable!("only poses are shifted"),
        }
    }

    /// The derivative of `local(base, c)` by a right perturbation of `c`, where `local` is its
    /// value; column-major into `out`, which is zero.
    pub(crate) fn local_jacobian(&self, base: &Value, c: &[f64], local: &[f64], out: &mut [f64]) {
        match self.group {
            Group::Pose2 => Pose2::load(base.storage()).local_jacobian(local, out),
            Group::Pose3 => Pose3::load(base.storage()).local_jacobian(local, out),
            Group::Rot3 => Rot3::load(base.storage()).local_jacobian(local, out),
            Group::Flat => (0..local.len()).for_each(|i| out[i * (local.len() + 1)] = 1.0),
            Group::Other => numeric_local_jacobian(base, c, out),
        }
    }

    /// `m Ad(c⁻¹)`: from the derivative by the coordinate to minus that by the root.
    pub(crate) fn transport(&self, c: &[f64], m: &[f64], out: &mut [f64]) {
        match self.group {
            Group::Pose2 => times_adjoint_of_inverse(&Pose2::load(c), m, out),
            Group::Pose3 => times_adjoint_of_inverse(&Pose3::load(c), m, out),
            _ => unreachable!("only poses are shifted"),
        }
    }
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
