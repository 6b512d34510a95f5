//! The matrices of measurements, kept small: most lines of a file have one of a few.

use std::ops::Deref;
use std::sync::Arc;

use smallvec::SmallVec;

/// The matrix of a measurement, as it stands in the file.
#[derive(Clone, Debug, PartialEq)]
pub struct Weight {
    /// What the matrix is.
    pub kind: WeightKind,
    /// The order of its entries.
    pub order: EntryOrder,
    /// The entries; empty when the line had none (identity).
    pub entries: Entries,
}

/// What the matrix of a measurement is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum WeightKind {
    /// Information, the inverse of the covariance.
    Information,
    /// Upper triangular `R` with information `RᵀR`.
    SquareRoot,
    /// Covariance.
    Covariance,
    /// Standard deviations, one for each row.
    Sigmas,
}

/// In which order the entries of a symmetric or triangular matrix are written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum EntryOrder {
    /// The upper triangle, row by row.
    UpperTriangle,
    /// TORO's 2D order `11 12 22 33 13 23`.
    Toro,
}

/// The entries of a matrix, read as a slice. Clones share them.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Entries(Option<Arc<SmallVec<[f64; 6]>>>);

impl Deref for Entries {
    type Target = [f64];

    fn deref(&self) -> &[f64] {
        self.0.as_deref().map_or(&[], |entries| entries.as_slice())
    }
}

impl<'a> IntoIterator for &'a Entries {
    type Item = &'a f64;
    type IntoIter = std::slice::Iter<'a, f64>;

    fn into_iter(self) -> Self::IntoIter {
        self.iter()
    }
}

impl From<SmallVec<[f64; 6]>> for Entries {
    fn from(entries: SmallVec<[f64; 6]>) -> Self {
        Self((!entries.is_empty()).then(|| Arc::new(entries)))
    }
}

impl From<&[f64]> for Entries {
    fn from(entries: &[f64]) -> Self {
        SmallVec::from_slice(entries).into()
    }
}

impl FromIterator<f64> for Entries {
    fn from_iter<T: IntoIterator<Item = f64>>(entries: T) -> Self {
        SmallVec::from_iter(entries).into()
    }
}

impl Entries {
    fn has_bits_of(&self, entries: &[f64]) -> bool {
        self.len() == entries.len()
            && self.iter().zip(entries).all(|(a, b)| a.to_bits() == b.to_bits())
    }
}

/// The matrices that were met last, which the next lines mostly have again.
#[derive(Debug, Default)]
pub(crate) struct Recent {
    entries: [Entries; 4],
    oldest: usize,
}

impl Recent {
    /// Entries with these bits, shared with those of a line before if they were met lately.
    pub fn share(&mut self, entries: SmallVec<[f64; 6]>) -> Entries {
        if let Some(met) = self.entries.iter().find(|met| met.has_bits_of(&entries)) {
            return met.clone();
        }
        let entries = Entries::from(entries);
        self.entries[self.oldest] = entries.clone();
        self.oldest = (self.oldest + 1) % self.entries.len();
        entries
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn equal_bits_are_shared_and_others_are_not() {
        let mut recent = Recent::default();
        let mut share = |entries: &[f64]| recent.share(SmallVec::from_slice(entries));
        let first = share(&[1.0, 0.0]);
        let (again, negative) = (share(&[1.0, 0.0]), share(&[1.0, -0.0]));
        let is_one = |a: &Entries, b: &Entries| {
            a.0.as_ref().zip(b.0.as_ref()).is_some_and(|(a, b)| Arc::ptr_eq(a, b))
        };
        assert!(is_one(&first, &again) && !is_one(&first, &negative));
        assert_eq!(negative[1].to_bits(), (-0.0_f64).to_bits());
        assert!(share(&[]).is_empty());
        for k in 0..5 {
            share(&[f64::from(k)]);
        }
        assert!(!is_one(&first, &share(&[1.0, 0.0])), "only the last few are kept");
    }
}
