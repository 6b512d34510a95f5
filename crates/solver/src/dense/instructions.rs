//! Which vector instructions the kernels use.

use pulp::{Arch, WithSimd};

use super::layout::FrontLayout;
use crate::settings::SettingsError;

/// The environment variable that forces a path; for tests, and to compare.
const VARIABLE: &str = "EVERGRAPH_SIMD";

/// The kernels' instruction sets: for vectors of at most four numbers and of at most eight.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Instructions {
    narrow: Arch,
    wide: Arch,
}

impl Instructions {
    /// The widest of this machine, or what `EVERGRAPH_SIMD` says (`scalar`, `avx2`, `avx512`).
    ///
    /// # Errors
    /// The variable names something that this machine does not have.
    pub(crate) fn select() -> Result<Self, SettingsError> {
        let Ok(name) = std::env::var(VARIABLE) else { return Ok(Self::widest()) };
        Self::available()
            .into_iter()
            .find(|(available, _)| *available == name)
            .map(|(_, instructions)| instructions)
            .ok_or(SettingsError {
                field: VARIABLE,
                value: name,
                must: "scalar, avx2 or avx512, and something that this processor has",
            })
    }

    fn widest() -> Self {
        Self::available().pop().map_or(Self::of(Arch::Scalar, Arch::Scalar), |(_, widest)| widest)
    }

    /// All that this machine has, by name, the widest last.
    pub(crate) fn available() -> Vec<(&'static str, Self)> {
        let mut available = vec![("scalar", Self::of(Arch::Scalar, Arch::Scalar))];
        #[cfg(target_arch = "x86_64")]
        if let Some(narrow) = pulp::x86::V3::try_new().map(Arch::V3) {
            available.push(("avx2", Self::of(narrow, narrow)));
            if let Some(wide) = pulp::x86::V4::try_new().map(Arch::V4) {
                available.push(("avx512", Self::of(narrow, wide)));
            }
        }
        #[cfg(not(target_arch = "x86_64"))]
        available.push(("native", Self::of(Arch::new(), Arch::new())));
        available
    }

    fn of(narrow: Arch, wide: Arch) -> Self {
        Self { narrow, wide }
    }

    /// Runs `op` compiled for the instructions that suit a front.
    #[inline]
    pub(crate) fn dispatch<Op: WithSimd>(self, layout: FrontLayout, op: Op) -> Op::Output {
        if layout.is_wide() { self.wide.dispatch(op) } else { self.narrow.dispatch(op) }
    }
}
