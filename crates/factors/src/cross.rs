//! Products with the matrix of a cross product.

use nalgebra::{SMatrix, Vector3};

/// `M [v]×`, without the multiplications by the zeros of `[v]×`.
#[inline(always)]
pub(crate) fn times_skew<const R: usize>(
    m: &SMatrix<f64, R, 3>,
    v: &Vector3<f64>,
) -> SMatrix<f64, R, 3> {
    let (x, y, z) = (m.column(0), m.column(1), m.column(2));
    SMatrix::from_columns(&[y * v.z - z * v.y, z * v.x - x * v.z, x * v.y - y * v.x])
}

#[cfg(test)]
mod tests {
    use super::*;
    use evergraph_model::geometry::skew;
    use nalgebra::Matrix2x3;

    #[test]
    fn it_is_the_product() {
        let (m, v) = (Matrix2x3::new(1.0, 2.0, 3.0, 4.0, 5.0, 6.0), Vector3::new(7.0, 8.0, 9.0));
        assert_eq!(times_skew(&m, &v), m * skew(&v));
    }
}
