//! Numbers that may carry a derivative.

pub use num_dual::{Dual64, DualNum};

/// The numbers of a residual: `f64`, or one that carries a derivative.
///
/// Has the operators, with `f64` on the right too, and the functions of [`DualNum`] (`sqrt`, `sin`,
/// `atan2`, …); `T::from(2.0)` is a constant, `x.re()` the plain value, to branch on.
pub trait Number: DualNum<Primitive = f64> + Copy {}
impl<T: DualNum<Primitive = f64> + Copy> Number for T {}
