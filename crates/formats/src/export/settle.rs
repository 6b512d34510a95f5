//! Numbers that read back as themselves.
//!
//! A pose is kept as cosine and sine or as a unit quaternion, a direction as a unit vector, a noise
//! as a square root of information, so that writing, reading and writing again moves last digits:
//! an angle through cosine and sine can creep on for thousands of times. Here angles and unit vectors
//! are rounded to [`DECIMALS`], which is more than one passage moves them, and matrices taken through
//! it until nothing moves.

use evergraph_model::Noise;
use nalgebra::Vector3;
use smallvec::SmallVec;

use crate::coordinates::Coordinates;
use crate::matrix;
use crate::weight::{EntryOrder, Weight, WeightKind};

/// To 14 decimals: the error of one passage is below 1e-15.
const DECIMALS: f64 = 1e14;

/// Passages after which a matrix is taken as it is; two or three nearly always do.
const ROUNDS: usize = 50;

pub(super) fn coordinates(at: Coordinates) -> Coordinates {
    match at {
        Coordinates::Pose2([x, y, theta]) => Coordinates::Pose2([x, y, rounded(theta)]),
        Coordinates::Pose3Quaternion([x, y, z, quaternion @ ..]) => {
            let [qx, qy, qz, qw] = unit(quaternion);
            Coordinates::Pose3Quaternion([x, y, z, qx, qy, qz, qw])
        }
        other => other,
    }
}

/// A direction of length one.
pub(super) fn direction(direction: &Vector3<f64>) -> [f64; 3] {
    unit((*direction).into())
}

fn rounded(x: f64) -> f64 {
    (x * DECIMALS).round() / DECIMALS
}

/// A vector of length one: all but the largest entry are rounded, and that one makes up for them.
fn unit<const N: usize>(vector: [f64; N]) -> [f64; N] {
    let mut unit = vector.map(rounded);
    let largest = (0..N).fold(0, |a, b| if unit[b].abs() > unit[a].abs() { b } else { a });
    let sign = unit[largest].signum();
    unit[largest] = 0.0;
    let others: f64 = unit.iter().map(|x| x * x).sum();
    unit[largest] = sign * (1.0 - others).max(0.0).sqrt();
    unit
}

/// The information of a noise.
pub(super) fn weight(noise: &Noise) -> Weight {
    let of = |noise: &Noise| Weight {
        kind: WeightKind::Information,
        order: EntryOrder::UpperTriangle,
        entries: matrix::entries(&noise.information(), EntryOrder::UpperTriangle),
    };
    let again = |weight: &Weight| {
        let read = matrix::as_written(weight, noise.dim())
            .and_then(|m| Noise::from_information_clipped(&m, f64::INFINITY).ok());
        read.map_or(weight.clone(), |(noise, _)| of(&noise))
    };
    settle(of(noise), |weight| &weight.entries, again)
}

/// Applies `again` until numbers come that were there before. Those from there on come again and
/// again, mostly one, and the smallest of them stands for all.
fn settle<T: Clone>(start: T, numbers: impl Fn(&T) -> &[f64], again: impl Fn(&T) -> T) -> T {
    let bits = |x: &T| numbers(x).iter().map(|x| x.to_bits()).collect::<SmallVec<[u64; 21]>>();
    let mut seen = vec![start];
    for _ in 0..ROUNDS {
        let next = again(&seen[seen.len() - 1]);
        if let Some(at) = seen.iter().position(|before| bits(before) == bits(&next)) {
            return seen[at..].iter().min_by_key(|x| bits(x)).cloned().unwrap_or(next);
        }
        seen.push(next);
    }
    seen.swap_remove(ROUNDS)
}

#[cfg(test)]
mod tests {
    use evergraph_model::{Pose2, Rot3};

    use super::*;

    #[test]
    fn rounded_rotations_read_back_as_themselves() {
        for k in -400_000..400_000 {
            let angle = rounded(f64::from(k) * 7.853e-6);
            let again = rounded(Pose2::new(0.0, 0.0, angle).theta());
            assert_eq!(again.to_bits(), angle.to_bits(), "{angle}");
        }
        for k in 1..200_000 {
            let k = f64::from(k);
            let [x, y, z, w] = [k, 3.1 * k, 0.7 * k + 1.0, 11.3 * k].map(f64::sin);
            let read = |[x, y, z, w]: [f64; 4]| Rot3::from_quaternion(x, y, z, w).unwrap();
            let written = unit(read([x, y, z, w]).quaternion());
            let again = unit(read(written).quaternion());
            assert_eq!(again.map(f64::to_bits), written.map(f64::to_bits));
        }
        assert_eq!(rounded(0.3), 0.3);
        assert_eq!(unit([0.0, 0.0, 0.0, 1.0]), [0.0, 0.0, 0.0, 1.0]);
        assert_eq!(unit([0.0, -1.0, 0.0]), [0.0, -1.0, 0.0]);
        let half = unit([0.0, 0.0, 0.5_f64.sqrt(), -0.5_f64.sqrt()]);
        assert!((half[2] + half[3]).abs() < 1e-13);
    }
}
