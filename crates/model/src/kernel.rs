//! Robust kernels: bounding the pull of measurements that may be wrong.

use std::any::Any;

use serde::{Deserialize, Serialize};
use smallvec::SmallVec;
use thiserror::Error;

use crate::arguments::{Arguments, Linearization};
use crate::factor::Factor;
use crate::key::VariableId;
use crate::manifold::VariableType;

/// A kernel threshold that is not a positive number.
#[derive(Clone, Debug, PartialEq, Error)]
#[error(
    "the threshold of a {kernel} kernel is {threshold}; it must be a positive finite number of standard deviations"
)]
pub struct KernelError {
    /// The kernel's name.
    pub kernel: &'static str,
    /// The threshold given.
    pub threshold: f64,
}

/// The loss `ρ(s)` of a squared whitened residual norm `s = ‖r‖²`, with `ρ(s) = ½ s` for small `s`.
///
/// The threshold `k` counts standard deviations: residuals with `‖r‖ < k` are trusted.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum Kernel {
    /// `ρ = ½ s` up to `s = k²`, then `k √s - ½ k²`: quadratic, then linear. 1.345 keeps 95 % of
    /// the efficiency on Gaussian noise for scalar residuals.
    #[non_exhaustive]
    Huber {
        /// Where the linear part begins.
        threshold: f64,
    },
    /// `ρ = k² (√(1 + s/k²) - 1)`: the same limits as Huber with all derivatives continuous.
    #[non_exhaustive]
    PseudoHuber {
        /// Where the linear part begins, softly.
        threshold: f64,
    },
}

impl Kernel {
    /// [`Kernel::Huber`].
    ///
    /// # Errors
    /// [`KernelError`] unless `threshold` is positive and finite.
    pub fn huber(threshold: f64) -> Result<Self, KernelError> {
        Self::checked(Self::Huber { threshold })
    }

    /// [`Kernel::PseudoHuber`].
    ///
    /// # Errors
    /// [`KernelError`] unless `threshold` is positive and finite.
    pub fn pseudo_huber(threshold: f64) -> Result<Self, KernelError> {
        Self::checked(Self::PseudoHuber { threshold })
    }

    fn checked(self) -> Result<Self, KernelError> {
        let (kernel, threshold) = (self.name(), self.threshold());
        // The square enters the loss and must neither vanish nor overflow.
        if (threshold * threshold).is_normal() && threshold > 0.0 {
            Ok(self)
        } else {
            Err(KernelError { kernel, threshold })
        }
    }

    /// `"Huber"`, `"PseudoHuber"`.
    pub fn name(&self) -> &'static str {
        match self {
            Self::Huber { .. } => "Huber",
            Self::PseudoHuber { .. } => "PseudoHuber",
        }
    }

    /// The threshold, in standard deviations.
    pub fn threshold(&self) -> f64 {
        match *self {
            Self::Huber { threshold } | Self::PseudoHuber { threshold } => threshold,
        }
    }

    /// `ρ(s)` of the squared norm `s`.
    pub fn rho(&self, squared_norm: f64) -> f64 {
        match *self {
            Self::Huber { threshold: k } if squared_norm > k * k => {
                k * squared_norm.sqrt() - 0.5 * k * k
            }
            Self::Huber { .. } => 0.5 * squared_norm,
            Self::PseudoHuber { .. } if squared_norm.is_infinite() => f64::INFINITY,
            // √(1 + u) - 1 = u / (1 + √(1 + u)), which does not cancel for small u.
            Self::PseudoHuber { threshold: k } => {
                squared_norm / (1.0 + (1.0 + squared_norm / (k * k)).sqrt())
            }
        }
    }

    /// `2 ρ'(s)`, the factor on the information in iteratively reweighted least squares; in (0, 1].
    pub fn weight(&self, squared_norm: f64) -> f64 {
        match *self {
            Self::Huber { threshold: k } if squared_norm > k * k => k / squared_norm.sqrt(),
            Self::Huber { .. } => 1.0,
            Self::PseudoHuber { threshold: k } => 1.0 / (1.0 + squared_norm / (k * k)).sqrt(),
        }
    }
}

/// A factor under a robust kernel.
///
/// The residual is the inner factor's; the error is `ρ(‖r‖²)` (of an inner factor with a loss of its
/// own, `ρ` of twice that); the linearization has all of its
/// rows, the residual's entries with them, scaled by the square root of the weight at that point
/// (iteratively reweighted least squares), so that its gradient is that of the error.
#[derive(Clone, Debug)]
pub struct Robust<F> {
    inner: F,
    kernel: Kernel,
}

impl<F: Factor> Robust<F> {
    /// Puts `inner` under `kernel`.
    pub fn new(inner: F, kernel: Kernel) -> Self {
        Self { inner, kernel }
    }

    /// The factor without the kernel.
    pub fn inner(&self) -> &F {
        &self.inner
    }

    /// The kernel.
    pub fn kernel(&self) -> Kernel {
        self.kernel
    }
}

impl dyn Factor {
    /// The factor as an `F`, and the kernel that it stands under, if it stands under one.
    pub fn downcast<F: Factor>(&self) -> Option<(&F, Option<Kernel>)> {
        let any = self.as_any();
        let bare = any.downcast_ref::<F>().map(|factor| (factor, None));
        bare.or_else(|| {
            any.downcast_ref::<Robust<F>>().map(|robust| (robust.inner(), Some(robust.kernel())))
        })
    }
}

impl<F: Factor> Factor for Robust<F> {
    fn name(&self) -> String {
        format!("Robust<{}, {}>", self.inner.name(), self.kernel.name())
    }

    fn keys(&self) -> &[VariableId] {
        self.inner.keys()
    }

    fn residual_dim(&self) -> usize {
        self.inner.residual_dim()
    }

    fn accepts(&self, position: usize, kind: &VariableType, dim: usize) -> bool {
        self.inner.accepts(position, kind, dim)
    }

    fn residual(&self, at: &Arguments<'_>, out: &mut [f64]) {
        self.inner.residual(at, out);
    }

    fn linearize(&self, at: &Arguments<'_>, out: &mut Linearization<'_>) {
        // The inner factor may be robust itself, so its loss counts and not the residual it writes.
        let mut residual: SmallVec<[f64; 8]> = SmallVec::from_elem(0.0, self.residual_dim());
        self.inner.residual(at, &mut residual);
        self.inner.linearize(at, out);
        let scale = self.kernel.weight(2.0 * self.inner.error(&residual)).sqrt();
        if scale < 1.0 {
            out.data_mut().iter_mut().for_each(|entry| *entry *= scale);
        }
    }

    fn error(&self, residual: &[f64]) -> f64 {
        self.kernel.rho(2.0 * self.inner.error(residual))
    }

    fn as_any(&self) -> &dyn Any {
        self
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn kernels() -> [Kernel; 4] {
        [
            Kernel::huber(1.345).unwrap(),
            Kernel::huber(0.01).unwrap(),
            Kernel::pseudo_huber(1.0).unwrap(),
            Kernel::pseudo_huber(20.0).unwrap(),
        ]
    }

    #[test]
    fn loss_and_weight_are_continuous_at_the_threshold() {
        for kernel in kernels() {
            let at = kernel.threshold().powi(2);
            let (below, above) = (at * (1.0 - 1e-9), at * (1.0 + 1e-9));
            assert!((kernel.rho(above) - kernel.rho(below)).abs() < 3e-9 * at);
            assert!((kernel.weight(above) - kernel.weight(below)).abs() < 3e-9);
        }
    }

    #[test]
    fn weight_is_twice_the_slope_of_the_loss() {
        for kernel in kernels() {
            let k2 = kernel.threshold().powi(2);
            for s in [0.1 * k2, 0.9 * k2, 1.1 * k2, 4.0 * k2, 400.0 * k2] {
                let step = 1e-5 * s;
                let slope = (kernel.rho(s + step) - kernel.rho(s - step)) / (2.0 * step);
                assert!((2.0 * slope - kernel.weight(s)).abs() < 1e-8, "{kernel:?} at {s}");
                assert!(kernel.weight(s) <= 1.0);
            }
        }
    }

    #[test]
    fn small_residuals_are_quadratic() {
        let huber = Kernel::huber(2.0).unwrap();
        assert_eq!(huber.rho(3.9), 1.95);
        assert_eq!(huber.weight(3.9), 1.0);
        let pseudo = Kernel::pseudo_huber(2.0).unwrap();
        assert_eq!(pseudo.rho(1e-20), 0.5e-20, "no cancellation");
    }

    #[test]
    fn large_residuals_are_linear() {
        for kernel in kernels() {
            let k = kernel.threshold();
            assert!((kernel.rho(1e12) / (k * 1e6) - 1.0).abs() < 1e-4);
        }
    }

    #[test]
    fn bad_thresholds_are_refused() {
        for threshold in [0.0, -1.0, f64::NAN, f64::INFINITY, 1e-300, 1e300] {
            assert!(Kernel::huber(threshold).is_err(), "{threshold}");
            assert!(Kernel::pseudo_huber(threshold).is_err(), "{threshold}");
        }
        let message = Kernel::huber(-1.0).unwrap_err().to_string();
        assert!(message.contains("Huber") && message.contains("-1"), "{message}");
    }
}
