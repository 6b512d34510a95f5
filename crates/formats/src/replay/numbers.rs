//! The measured numbers of an observation.

use evergraph_model::Point2;
use nalgebra::Vector3;

/// The measured numbers.
pub(super) struct Numbers<'a>(pub &'a [f64]);

impl Numbers<'_> {
    fn array<const N: usize>(&self, from: usize) -> Option<[f64; N]> {
        self.0.get(from..from + N)?.try_into().ok()
    }

    pub fn number(&self, at: usize) -> Option<f64> {
        self.array(at).map(|[x]| x)
    }

    pub fn vector3(&self, from: usize) -> Option<Vector3<f64>> {
        self.array::<3>(from).map(Vector3::from)
    }

    pub fn point2(&self, from: usize) -> Option<Point2> {
        self.array(from).map(|[x, y]| Point2::new(x, y))
    }
}
