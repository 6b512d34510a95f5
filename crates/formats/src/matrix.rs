//! The matrices of measurements: what they are, whether they can be, and from one kind to another.

use nalgebra::{DMatrix, DVector};

use crate::weight::{Entries, EntryOrder, Weight, WeightKind};

/// What a check of definiteness says.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Definiteness {
    /// All pivots are well above rounding.
    Positive,
    /// Singular to working precision, none negative.
    Semi,
    /// Negative by no more than the printed digits can have rounded away.
    Rounded,
    /// Negative; the smallest eigenvalue.
    Negative(f64),
}

/// Where entry `k` of the written order stands in an `n` by `n` upper triangle.
fn position(order: EntryOrder, n: usize, k: usize) -> (usize, usize) {
    if order == EntryOrder::Toro && n == 3 {
        return [(0, 0), (0, 1), (1, 1), (2, 2), (0, 2), (1, 2)][k.min(5)];
    }
    let (mut row, mut k) = (0, k);
    while k >= n - row {
        k -= n - row;
        row += 1;
    }
    (row, row + k)
}

/// How many rows a triangle of so many entries has.
fn rows(entries: usize) -> Option<usize> {
    (1..=6).find(|n| n * (n + 1) / 2 == entries)
}

/// The matrix as it is written, symmetric, (square root) upper triangular or diagonal; the identity when
/// nothing is written. `None` when the entries do not fit a matrix of `n` rows.
pub(crate) fn as_written(weight: &Weight, n: usize) -> Option<DMatrix<f64>> {
    if weight.entries.is_empty() {
        return Some(DMatrix::identity(n, n));
    }
    if weight.kind == WeightKind::Sigmas {
        let is_fit = weight.entries.len() == n;
        return is_fit
            .then(|| DMatrix::from_diagonal(&DVector::from_column_slice(&weight.entries)));
    }
    if rows(weight.entries.len()) != Some(n) {
        return None;
    }
    let mut matrix = DMatrix::zeros(n, n);
    for (k, &x) in weight.entries.iter().enumerate() {
        let (i, j) = position(weight.order, n, k);
        matrix[(i, j)] = x;
        if weight.kind != WeightKind::SquareRoot {
            matrix[(j, i)] = x;
        }
    }
    Some(matrix)
}

/// The entries of the upper triangle, in an order.
pub(crate) fn entries(matrix: &DMatrix<f64>, order: EntryOrder) -> Entries {
    let n = matrix.nrows();
    (0..n * (n + 1) / 2)
        .map(|k| {
            let (i, j) = position(order, n, k);
            matrix[(i, j)]
        })
        .collect()
}

/// Whether the entries make a positive definite matrix, by Cholesky on the stack; the usual case.
pub(crate) fn is_clearly_definite(weight: &Weight) -> bool {
    let Some(n) = rows(weight.entries.len()) else { return false };
    let mut a = [[0.0; 6]; 6];
    for (k, &x) in weight.entries.iter().enumerate() {
        let (i, j) = position(weight.order, n, k);
        a[j][i] = x;
    }
    for j in 0..n {
        let diagonal = a[j][j];
        let pivot = diagonal - a[j][..j].iter().map(|x| x * x).sum::<f64>();
        // Not `pivot <= ...`: a NaN from overflow is to take the careful path, too.
        if !(pivot > 1e-13 * diagonal && pivot.is_finite()) {
            return false;
        }
        let root = pivot.sqrt();
        a[j][j] = root;
        for i in j + 1..n {
            let dot: f64 = (0..j).map(|k| a[i][k] * a[j][k]).sum();
            a[i][j] = (a[i][j] - dot) / root;
        }
    }
    true
}

/// The careful check. `half_units[k]` is by how much rounding to the printed digits can have
/// changed entry `k`; empty when the entries are exact.
///
/// On the matrix scaled to unit diagonal, which has the same signs of eigenvalues: if a matrix
/// `A + E` with `|E| <= H` is positive semi-definite, then `A`'s smallest eigenvalue is at least
/// `-‖E‖ >= -‖H‖`, and the largest row sum bounds the norm.
pub(crate) fn definiteness(weight: &Weight, n: usize, half_units: &[f64]) -> Definiteness {
    let Some(matrix) = as_written(weight, n) else { return Definiteness::Negative(f64::NAN) };
    let largest = matrix.amax();
    if largest == 0.0 {
        return Definiteness::Semi;
    }
    let scale: Vec<f64> = (0..n)
        .map(|i| {
            if matrix[(i, i)] > 1e-12 * largest {
                matrix[(i, i)].sqrt()
            } else {
                largest.sqrt() * 1e-6
            }
        })
        .collect();
    let scaled = DMatrix::from_fn(n, n, |i, j| matrix[(i, j)] / scale[i] / scale[j]);
    let mut rounding = DMatrix::<f64>::zeros(n, n);
    for (k, &half) in half_units.iter().enumerate() {
        let (i, j) = position(weight.order, n, k);
        rounding[(i, j)] = half / scale[i] / scale[j];
        rounding[(j, i)] = rounding[(i, j)];
    }
    if !scaled.iter().all(|x| x.is_finite()) {
        return Definiteness::Negative(f64::NAN);
    }
    let norm = |m: &DMatrix<f64>| (0..n).map(|i| m.row(i).abs().sum()).fold(0.0, f64::max);
    let noise = 1e-14 * norm(&scaled);
    let smallest = smallest_eigenvalue(&scaled);
    if smallest > 1e-13 {
        Definiteness::Positive
    } else if smallest >= -noise {
        Definiteness::Semi
    } else if smallest >= -noise - norm(&rounding) {
        Definiteness::Rounded
    } else {
        Definiteness::Negative(smallest_eigenvalue(&matrix))
    }
}

fn smallest_eigenvalue(matrix: &DMatrix<f64>) -> f64 {
    // Scaled first: products of entries near the largest doubles overflow.
    let largest = matrix.amax();
    let eigenvalues = (matrix / largest).symmetric_eigenvalues();
    eigenvalues.iter().copied().fold(f64::INFINITY, f64::min) * largest
}

/// How far each printed number may be from what was rounded to it: half a unit in its last place.
///
/// Numbers that all have the same number of decimals were printed so (`%f`). Else trailing zeros
/// may be missing (`%g` prints 0.5 for 0.500000), so that a number is as precise as the one with
/// the most digits beside it, and a zero is a zero. A matrix of numbers of one or two digits was
/// typed, not measured: it is exact.
pub(crate) fn half_units(texts: &[&str]) -> Vec<f64> {
    let digits: Vec<Digits> = texts.iter().map(|text| Digits::of(text)).collect();
    let most = digits.iter().map(|d| d.significant).max().unwrap_or(0);
    let common = digits.first().and_then(|d| d.last_place);
    let fixed = common.filter(|_| digits.iter().all(|d| d.last_place == common));
    let half_unit = |d: &Digits| match (fixed, d.leading) {
        (Some(place), _) if most >= 3 || place <= -3 => 0.5 * 10f64.powi(place),
        (None, Some(leading)) if most >= 3 => {
            let unit = 10f64.powi(leading - most + 1);
            0.5 * d.last_place.map_or(unit, |place| unit.min(10f64.powi(place)))
        }
        _ => 0.0,
    };
    digits.iter().map(half_unit).collect()
}

/// The digits of a printed number.
struct Digits {
    /// Power of ten of the first digit that is not zero; `None` for zero.
    leading: Option<i32>,
    /// Significant digits, from the first that is not zero to the last printed after a point, or to
    /// the last that is not zero of a number without a point.
    significant: i32,
    /// Power of ten of the last printed digit; `None` without a point or exponent.
    last_place: Option<i32>,
}

impl Digits {
    fn of(text: &str) -> Self {
        let (mantissa, exponent) = match text.find(['e', 'E']) {
            Some(at) => (&text[..at], text[at + 1..].parse::<i32>().unwrap_or(0).clamp(-400, 400)),
            None => (text, 0),
        };
        let has_exponent = mantissa.len() < text.len();
        let mantissa = mantissa.trim_start_matches(['+', '-']);
        let (whole, fraction) = mantissa.split_once('.').unwrap_or((mantissa, ""));
        let clip = |n: usize| i32::try_from(n.min(2000)).unwrap_or(2000);
        let all = || whole.bytes().chain(fraction.bytes());
        let first = all().position(|b| b != b'0');
        let printed = clip(whole.len() + fraction.len());
        let pointed = mantissa.contains('.') || has_exponent;
        let last = if pointed {
            printed
        } else {
            clip(whole.len() - whole.bytes().rev().take_while(|&b| b == b'0').count())
        };
        Self {
            leading: first.map(|at| clip(whole.len()) - 1 - clip(at) + exponent),
            significant: first.map_or(0, |at| last - clip(at)),
            last_place: pointed.then(|| exponent - clip(fraction.len())),
        }
    }
}

/// The information matrix: of a covariance the inverse, of a square root `RᵀR`. `None` when there
/// is none.
pub(crate) fn information(weight: &Weight, n: usize) -> Option<DMatrix<f64>> {
    let matrix = as_written(weight, n)?;
    match weight.kind {
        WeightKind::Information => Some(matrix),
        WeightKind::SquareRoot => Some(matrix.transpose() * matrix),
        WeightKind::Sigmas => {
            Some(matrix.map(|sigma| if sigma == 0.0 { 0.0 } else { sigma.powi(-2) }))
        }
        WeightKind::Covariance => {
            let mut inverse = nalgebra::Cholesky::new(matrix)?.inverse();
            inverse.fill_lower_triangle_with_upper_triangle();
            Some(inverse)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn weight(entries: &[f64], order: EntryOrder) -> Weight {
        Weight { kind: WeightKind::Information, order, entries: entries.into() }
    }

    #[test]
    fn orders_place_the_same_entries() {
        // 1 2 3
        // 2 4 5
        // 3 5 6
        let rows =
            as_written(&weight(&[1.0, 2.0, 3.0, 4.0, 5.0, 6.0], EntryOrder::UpperTriangle), 3)
                .unwrap();
        let toro =
            as_written(&weight(&[1.0, 2.0, 4.0, 6.0, 3.0, 5.0], EntryOrder::Toro), 3).unwrap();
        assert_eq!(rows, toro);
        assert_eq!(entries(&rows, EntryOrder::Toro)[..], [1.0, 2.0, 4.0, 6.0, 3.0, 5.0]);
        let six: Vec<f64> = (0..21).map(f64::from).collect();
        let matrix = as_written(&weight(&six, EntryOrder::UpperTriangle), 6).unwrap();
        assert_eq!((matrix[(0, 5)], matrix[(1, 1)], matrix[(5, 5)]), (5.0, 6.0, 20.0));
        assert_eq!(entries(&matrix, EntryOrder::UpperTriangle)[..], six);
        assert!(as_written(&weight(&six, EntryOrder::UpperTriangle), 3).is_none());
    }

    #[test]
    fn half_units_are_those_of_the_last_printed_place() {
        let close = |texts: &[&str], expected: &[f64]| {
            let units = half_units(texts);
            let same = units.iter().zip(expected).all(|(a, b)| (a - b).abs() <= 1e-12 * b.abs());
            assert!(same && units.len() == expected.len(), "{texts:?}: {units:?}");
        };
        close(&["0.000000", "12.500000"], &[5e-7, 5e-7]);
        close(&["0.5", "0.333333", "0"], &[5e-7, 5e-7, 0.0]);
        close(&["1234.56", "-0.000123456", "1e-7"], &[5e-3, 5e-10, 5e-13]);
        close(&["500", "2", "0"], &[0.0, 0.0, 0.0]);
        close(&["1.5", "2", "x"], &[0.0, 0.0, 0.0]);
    }

    #[test]
    fn definiteness_does_not_depend_on_units() {
        for scale in [1e-300, 1e-12, 1.0, 1e12, 1e300] {
            let check = |entries: [f64; 3], half: &[f64]| {
                let scaled = weight(&entries.map(|x| x * scale), EntryOrder::UpperTriangle);
                let half: Vec<f64> = half.iter().map(|x| x * scale).collect();
                assert_eq!(is_clearly_definite(&scaled), entries == [2.0, 1.0, 2.0], "{scale}");
                definiteness(&scaled, 2, &half)
            };
            assert_eq!(check([2.0, 1.0, 2.0], &[]), Definiteness::Positive);
            assert_eq!(check([1.0, 1.0, 1.0], &[]), Definiteness::Semi);
            assert_eq!(check([0.0, 0.0, 0.0], &[]), Definiteness::Semi);
            assert_eq!(check([1.0, 1.001, 1.0], &[5e-4; 3]), Definiteness::Rounded);
            assert!(
                matches!(check([1.0, 1.01, 1.0], &[5e-4; 3]), Definiteness::Negative(x) if x < 0.0)
            );
            assert!(matches!(check([0.0, 1.0, 0.0], &[]), Definiteness::Negative(_)));
            assert!(matches!(check([-1.0, 0.0, 1.0], &[]), Definiteness::Negative(_)));
        }
    }
}
