//! Ordinary factors: relative poses, points seen from poses, priors.

use std::sync::Arc;

use evergraph_factors::{Between, LocalJacobian, Prior, RelativePosition2, RelativePosition3};
use evergraph_model::{
    Factor, Graph, LieGroup, Noise, Point2, Point3, Pose2, Pose3, Rot2, Rot3, VariableType, VectorN,
};
use nalgebra::{DMatrix, DVector, SMatrix, SVector};

use crate::error::MakeError;
use crate::member::Member;
use crate::motion::{carried, rotation_part};
use crate::potential::Potential;
use crate::target::Target;

/// The logarithm takes back an offset that turns by less than half a turn only; and an ordinary factor
/// that far from its measurement is better a linear one. Radians, the default of
/// [`Guard::rotation`](crate::Guard::rotation), which measures what remains of it as a linear one.
const FARTHEST: f64 = 1.0;

/// The ordinary factor for a term with its minimum at `offset`, if there is one. Types of users have none: their terms
/// become linear factors, which in a pair are linear in the relative coordinate only.
pub(crate) fn factor(
    graph: &Graph,
    target: &Target,
    potential: &Potential,
    offset: &DVector<f64>,
) -> Result<Option<Arc<dyn Factor>>, MakeError> {
    let member = |k: usize| &target.members[potential.members[k]];
    match potential.members.len() {
        1 => unary(graph, member(0), &potential.rows, offset),
        2 if potential.relative => pair(graph, member(0), member(1), &potential.rows, offset),
        _ => Ok(None),
    }
}

/// A prior at `z = x̂ Exp(d)`, x̂ where the member is seen. Its residual there is `e₀ = Log(z⁻¹ x̂) = -d` and its
/// Jacobian `W Jr⁻¹(e₀)`, so with `W = G Jr(e₀)` both information and gradient are those of the term:
/// `W e₀ = -G Jr(-d) d = -G d`, since `Jr(ξ) ξ = ξ`.
fn unary(
    graph: &Graph,
    member: &Member,
    rows: &DMatrix<f64>,
    offset: &DVector<f64>,
) -> Result<Option<Arc<dyn Factor>>, MakeError> {
    let kind = member.value.kind();
    let makers: [(&VariableType, Unary); 7] = [
        (VariableType::of::<Pose2>(), group_prior::<Pose2, 3>),
        (VariableType::of::<Pose3>(), group_prior::<Pose3, 6>),
        (VariableType::of::<Rot2>(), group_prior::<Rot2, 1>),
        (VariableType::of::<Rot3>(), group_prior::<Rot3, 3>),
        (VariableType::of::<Point2>(), group_prior::<Point2, 2>),
        (VariableType::of::<Point3>(), group_prior::<Point3, 3>),
        (VariableType::of::<VectorN>(), vector_prior),
    ];
    match makers.iter().find(|maker| maker.0 == kind) {
        Some((_, make)) => make(graph, member, rows, offset),
        None => Ok(None),
    }
}

/// The prior of a type for a member, its rows and its offset.
type Unary =
    fn(&Graph, &Member, &DMatrix<f64>, &DVector<f64>) -> Result<Option<Arc<dyn Factor>>, MakeError>;

fn vector_prior(
    graph: &Graph,
    member: &Member,
    rows: &DMatrix<f64>,
    offset: &DVector<f64>,
) -> Result<Option<Arc<dyn Factor>>, MakeError> {
    let Some(x) = member.value.get::<VectorN>() else { return Ok(None) };
    let z = VectorN::new((x.vector() + offset).as_slice().to_vec());
    Ok(Some(Arc::new(Prior::new(graph.key(member.id)?, z, noise(rows)?)?)))
}

fn group_prior<G: LieGroup<N> + LocalJacobian, const N: usize>(
    graph: &Graph,
    member: &Member,
    rows: &DMatrix<f64>,
    offset: &DVector<f64>,
) -> Result<Option<Arc<dyn Factor>>, MakeError> {
    let Some(x) = member.value.get::<G>() else { return Ok(None) };
    if turn(member, offset) > FARTHEST {
        return Ok(None);
    }
    let d = SVector::<f64, N>::from_column_slice(offset.as_slice());
    let z = x.compose(&G::exp(&d));
    let noise = noise(&times(rows, &G::right_jacobian(&-d)))?;
    Ok(Some(Arc::new(Prior::new(graph.key::<G>(member.id)?, z, noise)?)))
}

/// What is seen of the second from the first: the offset of the relative coordinate is
/// `d = d_2 - A d_1`.
fn pair(
    graph: &Graph,
    first: &Member,
    second: &Member,
    rows: &DMatrix<f64>,
    offset: &DVector<f64>,
) -> Result<Option<Arc<dyn Factor>>, MakeError> {
    let (n, m) = (first.value.dim(), second.value.dim());
    let Some(motion) = carried(&first.value, &second.value) else { return Ok(None) };
    let d = offset.rows(n, m) - motion * offset.rows(0, n);
    let rows = rows.columns(n, m).into_owned();
    let (plane, space) = (VariableType::of::<Pose2>(), VariableType::of::<Pose3>());
    let makers: [(&VariableType, &VariableType, Pair); 4] = [
        (plane, VariableType::of::<Point2>(), position2),
        (space, VariableType::of::<Point3>(), position3),
        (plane, plane, between::<Pose2, 3>),
        (space, space, between::<Pose3, 6>),
    ];
    let kinds = (first.value.kind(), second.value.kind());
    match makers.iter().find(|maker| (maker.0, maker.1) == kinds) {
        Some((_, _, make)) => make(graph, first, second, rows, &d),
        None => Ok(None),
    }
}

/// The relative factor of two types, for the members, the rows and the offset of the second.
type Pair = fn(
    &Graph,
    &Member,
    &Member,
    DMatrix<f64>,
    &DVector<f64>,
) -> Result<Option<Arc<dyn Factor>>, MakeError>;

/// `z = T⁻¹ p̂ + Cᵀ d`; the Jacobian by the point is `W Cᵀ`, so `W = G C`.
fn position2(
    graph: &Graph,
    first: &Member,
    second: &Member,
    rows: DMatrix<f64>,
    d: &DVector<f64>,
) -> Result<Option<Arc<dyn Factor>>, MakeError> {
    let (Some(pose), Some(point)) = (first.value.get::<Pose2>(), second.value.get::<Point2>())
    else {
        return Ok(None);
    };
    let c = pose.rotation();
    let turn = DMatrix::from_row_slice(2, 2, &[c.cos(), -c.sin(), c.sin(), c.cos()]);
    let seen = pose.inverse_transform_point(&point).vector() + turn.tr_mul(d);
    let seen = Point2::new(seen[0], seen[1]);
    let keys = (graph.key::<Pose2>(first.id)?, graph.key::<Point2>(second.id)?);
    let factor = RelativePosition2::new(keys.0, keys.1, seen, noise(&(rows * turn))?)?;
    Ok(Some(Arc::new(factor)))
}

/// [`position2`] in space.
fn position3(
    graph: &Graph,
    first: &Member,
    second: &Member,
    rows: DMatrix<f64>,
    d: &DVector<f64>,
) -> Result<Option<Arc<dyn Factor>>, MakeError> {
    let (Some(pose), Some(point)) = (first.value.get::<Pose3>(), second.value.get::<Point3>())
    else {
        return Ok(None);
    };
    let turn = DMatrix::from_column_slice(3, 3, pose.rotation().matrix().as_slice());
    let seen = pose.inverse_transform_point(&point).vector() + turn.tr_mul(d);
    let seen = Point3::new(seen[0], seen[1], seen[2]);
    let keys = (graph.key::<Pose3>(first.id)?, graph.key::<Point3>(second.id)?);
    let factor = RelativePosition3::new(keys.0, keys.1, seen, noise(&(rows * turn))?)?;
    Ok(Some(Arc::new(factor)))
}

/// `z = x̂_ij Exp(d)`, with the residual `-d` where the members are seen and `W = G Jr(-d)` as for a prior.
fn between<G: LieGroup<N>, const N: usize>(
    graph: &Graph,
    first: &Member,
    second: &Member,
    rows: DMatrix<f64>,
    offset: &DVector<f64>,
) -> Result<Option<Arc<dyn Factor>>, MakeError> {
    let (Some(from), Some(to)) = (first.value.get::<G>(), second.value.get::<G>()) else {
        return Ok(None);
    };
    if turn(second, offset) > FARTHEST {
        return Ok(None);
    }
    let d = SVector::<f64, N>::from_column_slice(offset.as_slice());
    let z = from.between(&to).compose(&G::exp(&d));
    let noise = noise(&times(&rows, &G::right_jacobian(&-d)))?;
    let (from, to) = (graph.key::<G>(first.id)?, graph.key::<G>(second.id)?);
    Ok(Some(Arc::new(Between::<G, N>::new(from, to, z, noise)?)))
}

/// The rotation in an offset of a member.
fn turn(member: &Member, offset: &DVector<f64>) -> f64 {
    let dim = rotation_part(member.value.kind());
    offset.rows(offset.len() - dim, dim).norm()
}

fn times<const N: usize>(rows: &DMatrix<f64>, m: &SMatrix<f64, N, N>) -> DMatrix<f64> {
    rows * DMatrix::from_column_slice(N, N, m.as_slice())
}

/// A square root with as many rows as columns; missing rows know nothing.
fn noise(rows: &DMatrix<f64>) -> Result<Noise, MakeError> {
    let n = rows.ncols();
    let mut square = DMatrix::zeros(n, n);
    square.rows_mut(0, rows.nrows().min(n)).copy_from(&rows.rows(0, rows.nrows().min(n)));
    Ok(Noise::from_sqrt_information(&square)?)
}
