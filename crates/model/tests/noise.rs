//! Noise constructors on good and bad numbers.

use evergraph_model::{Noise, NoiseError};
use nalgebra::{DMatrix, DVector, Matrix3};
use proptest::prelude::*;

type Constructor = fn(&DMatrix<f64>) -> Result<Noise, NoiseError>;

fn relative(a: &DMatrix<f64>, b: &DMatrix<f64>) -> f64 {
    (a - b).amax() / b.amax()
}

fn assert_upper(noise: &Noise) {
    let r = noise.sqrt_information();
    for j in 0..r.ncols() {
        assert!(r[(j, j)] >= 0.0);
        assert!((j + 1..r.nrows()).all(|i| r[(i, j)] == 0.0), "{r}");
    }
}

#[test]
fn every_constructor_says_what_its_numbers_are() {
    let sigmas = Noise::from_sigmas(&[0.5, 0.1, 2.0]).unwrap();
    let information = DMatrix::from_diagonal(&DVector::from_column_slice(&[4.0, 100.0, 0.25]));
    assert!(relative(&sigmas.information(), &information) < 1e-15);
    let same = [
        Noise::from_information(&information).unwrap(),
        Noise::from_covariance(&information.clone().try_inverse().unwrap()).unwrap(),
        Noise::from_sqrt_information(&information.map(f64::sqrt)).unwrap(),
    ];
    for noise in same {
        assert!(relative(noise.sqrt_information(), sigmas.sqrt_information()) < 1e-15);
    }
    assert_eq!(Noise::isotropic(2, 0.5).unwrap(), Noise::from_sigmas(&[0.5, 0.5]).unwrap());
}

#[test]
fn a_root_of_any_shape_becomes_upper_triangular_with_the_same_information() {
    let root = DMatrix::from_row_slice(3, 3, &[0.0, 1.0, 2.0, -3.0, 0.5, 0.0, 1.0, 1.0, 1.0]);
    let noise = Noise::from_sqrt_information(&root).unwrap();
    assert_upper(&noise);
    assert!(relative(&noise.information(), &root.tr_mul(&root)) < 1e-15);
    let upper = DMatrix::from_row_slice(2, 2, &[-2.0, 1.0, 0.0, 3.0]);
    let noise = Noise::from_sqrt_information(&upper).unwrap();
    assert_eq!(
        noise.sqrt_information().as_slice(),
        [2.0, 0.0, -1.0, 3.0],
        "only signs of rows change"
    );
}

#[test]
fn singular_information_is_kept() {
    // Ranks 1 of 2 and 2 of 3, and nothing known at all.
    let ones = DMatrix::from_element(2, 2, 1.0);
    let mut flat = DMatrix::zeros(3, 3);
    flat[(0, 0)] = 1e8;
    flat[(2, 2)] = 1e-8;
    for information in [ones, flat, DMatrix::zeros(2, 2)] {
        let noise = Noise::from_information(&information).unwrap();
        assert_upper(&noise);
        let difference = (noise.information() - &information).amax();
        assert!(difference <= 1e-15 * information.amax(), "{information}{}", noise.information());
    }
}

#[test]
fn a_barely_positive_matrix_keeps_its_small_eigenvalue() {
    // Eigenvalues 100 and 1.5e-9, axes at 45 degrees.
    let (large, small): (f64, f64) = (100.0, 1.5e-9);
    let (a, b) = ((large + small) / 2.0, (large - small) / 2.0);
    let information = DMatrix::from_row_slice(2, 2, &[a, b, b, a]);
    let noise = Noise::from_information(&information).unwrap();
    let smallest = noise.information().symmetric_eigenvalues().min();
    assert!((smallest - small).abs() < 1e-13, "{smallest}");
}

#[test]
fn units_do_not_decide_what_is_rounding() {
    // Indefinite only in the second, tiny block: small against 1e12, not against itself.
    let information =
        DMatrix::from_row_slice(3, 3, &[1e12, 0.0, 0.0, 0.0, 1e-6, 2e-6, 0.0, 2e-6, 1e-6]);
    let error = Noise::from_information(&information).unwrap_err();
    assert!(
        matches!(error, NoiseError::Indefinite { eigenvalue, .. } if (eigenvalue + 1e-6).abs() < 1e-9),
        "{error}"
    );
}

#[test]
fn negative_eigenvalues_are_named_or_clipped() {
    // A correlation of one, printed as 1.00001: eigenvalues 2 and -1e-5.
    let printed = DMatrix::from_row_slice(2, 2, &[1.0, 1.00001, 1.00001, 1.0]);
    let error = Noise::from_information(&printed).unwrap_err();
    let NoiseError::Indefinite { eigenvalue, largest } = error.clone() else { panic!("{error}") };
    assert!((eigenvalue + 1e-5).abs() < 1e-12 && (largest - 2.00001).abs() < 1e-12);
    assert!(error.to_string().contains("from_information_clipped"));
    assert!(Noise::from_information_clipped(&printed, 1e-6).is_err());
    let (noise, clipped) = Noise::from_information_clipped(&printed, 1e-4).unwrap();
    assert!(clipped);
    assert!(noise.information().symmetric_eigenvalues().min() > -1e-15);
    assert!((noise.information() - printed).amax() < 1e-5);
    let good = DMatrix::from_row_slice(2, 2, &[2.0, 1.0, 1.0, 2.0]);
    assert!(!Noise::from_information_clipped(&good, 1e-4).unwrap().1);
    let zero_diagonal = DMatrix::from_row_slice(2, 2, &[0.0, 1.0, 1.0, 0.0]);
    assert!(Noise::from_information_clipped(&zero_diagonal, 1e-3).is_err());
    assert!(Noise::from_information(&DMatrix::from_element(1, 1, -1.0)).is_err());
}

#[test]
fn bad_input_is_a_typed_error() {
    for sigma in [0.0, -1.0, f64::NAN, f64::INFINITY, 1e-200, 1e200] {
        let error = Noise::from_sigmas(&[1.0, sigma]).unwrap_err();
        assert!(matches!(error, NoiseError::BadSigma { index: 1, .. }), "{sigma}");
    }
    assert_eq!(Noise::from_sigmas(&[]), Err(NoiseError::Empty));
    assert_eq!(Noise::isotropic(0, 1.0), Err(NoiseError::Empty));
    let constructors: [Constructor; 3] =
        [Noise::from_information, Noise::from_covariance, Noise::from_sqrt_information];
    for constructor in constructors {
        assert!(matches!(
            constructor(&DMatrix::zeros(2, 3)),
            Err(NoiseError::NotSquare { rows: 2, columns: 3, .. })
        ));
        assert_eq!(constructor(&DMatrix::zeros(0, 0)), Err(NoiseError::Empty));
        for bad in [f64::NAN, f64::INFINITY] {
            let mut matrix = DMatrix::identity(3, 3);
            matrix[(1, 2)] = bad;
            let error = constructor(&matrix).unwrap_err();
            assert!(matches!(error, NoiseError::NotFinite { row: 1, column: 2, .. }), "{error}");
        }
    }
    let lopsided = DMatrix::from_row_slice(2, 2, &[1.0, 0.5, 0.0, 1.0]);
    for constructor in &constructors[..2] {
        let error = constructor(&lopsided).unwrap_err();
        assert!(matches!(error, NoiseError::NotSymmetric { row: 0, column: 1, .. }), "{error}");
    }
    let singular = DMatrix::from_element(2, 2, 1.0);
    assert!(matches!(
        Noise::from_covariance(&singular),
        Err(NoiseError::SingularCovariance { .. })
    ));
}

#[test]
fn fixed_has_the_asked_size_or_is_none() {
    let noise = Noise::from_sqrt_information(&DMatrix::from_fn(3, 3, |i, j| {
        if j >= i { 1.0 + j as f64 } else { 0.0 }
    }));
    let noise = noise.unwrap();
    assert_eq!(noise.fixed::<3>(), Some(Matrix3::new(1.0, 2.0, 3.0, 0.0, 2.0, 3.0, 0.0, 0.0, 3.0)));
    assert_eq!(noise.fixed::<2>(), None);
    assert_eq!(noise.fixed::<6>(), None);
}

proptest! {
    #[test]
    fn covariance_and_information_are_inverses(entries in proptest::collection::vec(-1.0..1.0, 36), scale in -4.0..4.0) {
        let root = DMatrix::<f64>::from_vec(6, 6, entries) + DMatrix::<f64>::identity(6, 6) * 2.5;
        let information = root.tr_mul(&root) * 10_f64.powf(scale);
        let from_information = Noise::from_information(&information).unwrap();
        assert_upper(&from_information);
        prop_assert!(relative(&from_information.information(), &information) < 1e-14);
        let covariance = information.clone().try_inverse().unwrap();
        let symmetric = (&covariance + covariance.transpose()) * 0.5;
        let from_covariance = Noise::from_covariance(&symmetric).unwrap();
        assert_upper(&from_covariance);
        prop_assert!(relative(from_covariance.sqrt_information(), from_information.sqrt_information()) < 1e-9);
    }

    #[test]
    fn information_of_any_rank_is_kept(entries in proptest::collection::vec(-1.0..1.0, 36), rank in 0_usize..6, units in proptest::collection::vec(-3.0..3.0, 6)) {
        let mut root = DMatrix::<f64>::from_vec(6, 6, entries);
        root.rows_mut(rank, 6 - rank).fill(0.0);
        for (j, unit) in units.iter().enumerate() {
            root.column_mut(j).scale_mut(10_f64.powf(*unit));
        }
        let information = root.tr_mul(&root);
        let noise = Noise::from_information(&information).unwrap();
        assert_upper(&noise);
        let kept = noise.information();
        for i in 0..6 {
            for j in 0..6 {
                let size = (information[(i, i)] * information[(j, j)]).sqrt();
                prop_assert!((kept[(i, j)] - information[(i, j)]).abs() <= 1e-13 * size + 1e-300);
            }
        }
    }

    #[test]
    fn whitening_columns_multiplies_them(entries in proptest::collection::vec(-1.0..1.0, 25), columns in proptest::collection::vec(-9.0..9.0, 15)) {
        let noise = Noise::from_sqrt_information(&DMatrix::from_vec(5, 5, entries)).unwrap();
        let matrix = DMatrix::from_vec(5, 3, columns);
        let expected = noise.sqrt_information() * &matrix;
        let mut whitened = matrix;
        noise.whiten_columns(whitened.as_mut_slice());
        prop_assert!((whitened - expected).amax() < 1e-13);
    }
}
