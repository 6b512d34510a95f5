//! What is saved comes back, and what could not have been saved is refused.

use evergraph_model::{Kernel, Noise, Pose2, Pose3, Rot3, VectorN};
use nalgebra::{DMatrix, Vector3};
use serde::Serialize;
use serde::de::DeserializeOwned;

fn round_trip<T: Serialize + DeserializeOwned + PartialEq + std::fmt::Debug>(value: &T) {
    let text = serde_json::to_string(value).expect("plain numbers");
    assert_eq!(&serde_json::from_str::<T>(&text).expect("what was saved"), value, "{text}");
}

#[test]
fn values_noises_and_kernels_round_trip() {
    round_trip(&Pose2::new(1.0, 2.0, 0.0));
    round_trip(&Pose3::new(
        Rot3::from_quaternion(0.5, 0.5, -0.5, 0.5).unwrap(),
        Vector3::new(1.0, 2.0, 3.0),
    ));
    round_trip(&VectorN::new([1.0, -2.5]));
    round_trip(&Kernel::huber(1.5).unwrap());
    let root = DMatrix::from_row_slice(3, 3, &[1.0, 2.0, 3.0, 0.0, 4.0, 5.0, 0.0, 0.0, 6.0]);
    round_trip(&Noise::from_sqrt_information(&root).unwrap());
    let text = serde_json::to_string(&Noise::from_sqrt_information(&root).unwrap()).unwrap();
    assert_eq!(text, r#"{"dim":3,"upper":[1.0,2.0,3.0,4.0,5.0,6.0]}"#);
}

#[test]
fn a_damaged_noise_is_refused() {
    for text in [
        r#"{"dim":3,"upper":[1.0,2.0,3.0]}"#,
        r#"{"dim":0,"upper":[]}"#,
        r#"{"dim":2,"upper":[1.0,2.0,3.0,4.0]}"#,
        r#"{"dim":18446744073709551615,"upper":[1.0]}"#,
    ] {
        assert!(serde_json::from_str::<Noise>(text).is_err(), "{text}");
    }
}
