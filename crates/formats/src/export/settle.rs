//! Numbers that read back as themselves.
//!
//! A pose is kept as cosine and sine or as a unit quaternion, a noise as a square root of
//! information, so that writing, reading and writing again would move last digits each time. Here
//! that is done beforehand, until nothing moves.

use evergraph_model::{Noise, Pose2, Rot3};
use nalgebra::Vector3;

use crate::matrix;
use crate::record::Coordinates;
use crate::weight::{EntryOrder, Weight, WeightKind};

/// Two or three rounds nearly always do.
const ROUNDS: usize = 50;

fn settle<const N: usize>(
    mut numbers: [f64; N],
    read_and_write: impl Fn([f64; N]) -> [f64; N],
) -> [f64; N] {
    for _ in 0..ROUNDS {
        let again = read_and_write(numbers);
        if again.map(f64::to_bits) == numbers.map(f64::to_bits) {
            break;
        }
        numbers = again;
    }
    numbers
}

pub(super) fn coordinates(at: Coordinates) -> Coordinates {
    match at {
        Coordinates::Pose2(pose) => Coordinates::Pose2(settle(pose, |[x, y, theta]| {
            [x, y, Pose2::new(x, y, theta).theta()]
        })),
        Coordinates::Pose3Quaternion([x, y, z, quaternion @ ..]) => {
            let [qx, qy, qz, qw] = settle(quaternion, |[x, y, z, w]| {
                Rot3::from_quaternion(x, y, z, w).map_or([x, y, z, w], |r| r.quaternion())
            });
            Coordinates::Pose3Quaternion([x, y, z, qx, qy, qz, qw])
        }
        other => other,
    }
}

/// A direction of length one.
pub(super) fn direction(direction: &Vector3<f64>) -> [f64; 3] {
    settle((*direction).into(), |numbers| {
        let v = Vector3::from(numbers);
        (v / v.amax()).normalize().into()
    })
}

/// The information of a noise.
pub(super) fn weight(noise: &Noise) -> Weight {
    let of = |noise: &Noise| Weight {
        kind: WeightKind::Information,
        order: EntryOrder::UpperTriangle,
        entries: matrix::entries(&noise.information(), EntryOrder::UpperTriangle),
    };
    let mut weight = of(noise);
    for _ in 0..ROUNDS {
        let again = matrix::as_written(&weight, noise.dim())
            .and_then(|m| Noise::from_information_clipped(&m, f64::INFINITY).ok())
            .map(|(noise, _)| of(&noise));
        match again {
            Some(again) if again.has_bits_of(&weight) => break,
            Some(again) => weight = again,
            None => break,
        }
    }
    weight
}
