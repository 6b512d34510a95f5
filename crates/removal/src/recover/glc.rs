//! Generic linear constraints (sections II-C and II-D of the GLC paper).

use evergraph_factors::{Linear, RootShift};
use evergraph_model::{Value, VariableId};
use nalgebra::{DMatrix, DVector};

use crate::error::MakeError;
use crate::motion::carried;
use crate::options::{Options, Rank};
use crate::potential::Potential;
use crate::target::Target;

/// `e = G' (Local(x̂', r(x)) - d')` with `G' = G R⁻¹`, `d' = R d` and R the Jacobian of the root
/// shift r, so that
///
/// ```text
/// Λ' = G'ᵀ G' = R⁻ᵀ Λ R⁻¹                                        (6)
/// ```
///
/// and the factor contributes exactly `GᵀG = Λ` (section II-D: there G is `D^½ Uᵀ` from the
/// eigenvectors of Λ', equations 8 and 9; any other square root of as many rows is a rotation of
/// it, and one that comes from QR has seen no squares).
///
/// R is `[A 0; C B]` with B diagonal by blocks: an identity for every variable but points that are seen
/// from the root, where it is the rotation of their axes; hence `G'_k = G_k B_k⁻¹` and
/// `G'_1 = (G_1 - Σ G'_k C_k) A⁻¹`.
pub(crate) fn factor(
    target: &Target,
    potential: &Potential,
    offset: &DVector<f64>,
    options: &Options,
) -> Result<Option<Linear>, MakeError> {
    let variables: Vec<(VariableId, Value)> = potential
        .members
        .iter()
        .map(|&m| (target.members[m].id, target.members[m].value.clone()))
        .collect();
    let shift = shift(&variables, options.root_shift);
    let (mut rows, mut offset) = (potential.rows.clone(), offset.clone());
    if shift != RootShift::None {
        let points: Vec<Value> = variables.iter().map(|(_, value)| value.clone()).collect();
        let jacobian = shift.jacobian(&points)?;
        let dim = points[0].dim();
        let mut first = rows.columns(0, dim).into_owned();
        let mut column = dim;
        // Relative: G_1 = -Σ G_k A_k, and C_k = -B_k A_k for every shifted variable, so that only what
        // stays in the world is left. Summed up like this nothing has to cancel, and where nothing
        // stays there the root's columns are exactly zero.
        if potential.relative {
            first.fill(0.0);
        }
        for point in &points[1..] {
            let n = point.dim();
            let is_seen = shift.sees(points[0].kind(), point.kind());
            let own = jacobian.view((column, column), (n, n)).into_owned();
            let turned = rows.columns(column, n) * inverse(own)?;
            if potential.relative {
                if let (false, Some(motion)) = (is_seen, carried(&points[0], point)) {
                    first -= &turned * motion;
                }
            } else {
                first -= &turned * jacobian.view((column, 0), (n, dim));
            }
            rows.columns_mut(column, n).copy_from(&turned);
            column += n;
        }
        let corner = jacobian.view((0, 0), (dim, dim)).into_owned();
        if shift == RootShift::InverseRoot {
            let inverse = corner.try_inverse().ok_or(MakeError::NotFinite("its root shift"))?;
            first *= inverse;
        }
        let vanishes = first.iter().all(|&x| x == 0.0);
        rows.columns_mut(0, dim).copy_from(&first);
        offset = jacobian * offset;
        if vanishes {
            // Nothing is known there, so no offset means anything.
            offset.rows_mut(0, dim).fill(0.0);
        }
    }
    if let Rank::Absolute(tolerance) = options.rank {
        rows = principal(&rows, tolerance)?;
    }
    if rows.nrows() == 0 {
        return Ok(None);
    }
    Ok(Some(Linear::new(&variables, shift, rows, offset)?))
}

/// The inverse of a block B: its transpose where it is a rotation, which all types of this library have.
fn inverse(block: DMatrix<f64>) -> Result<DMatrix<f64>, MakeError> {
    /// Deviation from a rotation that counts as rounding.
    const ROUNDING: f64 = 1e-9;
    let n = block.nrows();
    if (block.tr_mul(&block) - DMatrix::identity(n, n)).amax() <= ROUNDING {
        return Ok(block.transpose());
    }
    block.try_inverse().ok_or(MakeError::NotFinite("its root shift"))
}

/// Only where another variable is there to be seen from the first: unary factors gain nothing.
fn shift(variables: &[(VariableId, Value)], wanted: RootShift) -> RootShift {
    let root = variables[0].1.kind();
    let is_seen = |(_, value): &(VariableId, Value)| wanted.sees(root, value.kind());
    if variables[1..].iter().any(is_seen) { wanted } else { RootShift::None }
}

/// `D^½ Uᵀ` of equations 8 and 9, with the eigenvalues above an absolute tolerance times their
/// number, as iSAM 1.7 takes them.
fn principal(rows: &DMatrix<f64>, tolerance: f64) -> Result<DMatrix<f64>, MakeError> {
    let information = rows.tr_mul(rows);
    if information.iter().any(|x| !x.is_finite()) {
        return Err(MakeError::NotFinite("its information"));
    }
    let eigen = information.symmetric_eigen();
    let n = eigen.eigenvalues.len();
    let kept: Vec<usize> =
        (0..n).filter(|&k| eigen.eigenvalues[k] > tolerance * n as f64).collect();
    Ok(DMatrix::from_fn(kept.len(), n, |i, j| {
        eigen.eigenvalues[kept[i]].sqrt() * eigen.eigenvectors[(j, kept[i])]
    }))
}
