//! One clique by Cholesky: assemble the front where its numbers will stay, factor the frontal
//! columns; the rest is the contribution.

use pulp::{Simd, WithSimd};

use super::assembly::{Assembly, add_contribution, add_factor};
use super::system::{CHOLESKY_PIVOT, CHOLESKY_PRODUCT, System};
use super::workspace::Workspace;
use crate::dense::{BadPivot, PartialCholesky, PivotBound, SubtractOuter, partial_cholesky};
use crate::profile::Phase;
use crate::tree::{Form, Numeric, Structure};

/// Eliminates a clique from its factors and its children's contributions.
pub(super) fn eliminate(
    system: &System<'_>,
    structure: &Structure,
    children: &[(&Structure, &Numeric)],
    workspace: &mut Workspace,
) -> Result<Numeric, BadPivot> {
    let layout = structure.layout();
    let mut data = workspace.pool.take(Numeric::len(layout, Form::Information));
    let weakest = weakest_of(children);
    let op = Eliminate { system, structure, children, weakest, data: &mut data, workspace };
    match system.instructions.dispatch(layout, op) {
        Ok(pivot_ratio) => Ok(Numeric {
            layout,
            form: Form::Information,
            data,
            pivot_ratio,
            weakest: weakest.min(pivot_ratio),
        }),
        Err(bad) => {
            workspace.pool.give(data);
            Err(bad)
        }
    }
}

/// The numbers, less the panel, of the first frontals of a clique with the numbers `whole`: the
/// contribution is what its factors and children say of the rest, less the products of the panel.
pub(super) fn prefix(
    system: &System<'_>,
    structure: &Structure,
    children: &[(&Structure, &Numeric)],
    whole: &Numeric,
    workspace: &mut Workspace,
) -> Numeric {
    let layout = structure.layout();
    let len = Numeric::len(layout, Form::Information) - layout.panel_len();
    let mut data = workspace.pool.take(len);
    let panel = &whole.data[..layout.panel_len()];
    let op = Contribute { system, structure, children, panel, data: &mut data, workspace };
    let pivot_ratio = system.instructions.dispatch(layout, op);
    let weakest = weakest_of(children).min(pivot_ratio);
    Numeric { layout, form: Form::Information, data, pivot_ratio, weakest }
}

/// The smallest pivot ratio below a clique.
pub(super) fn weakest_of(children: &[(&Structure, &Numeric)]) -> f64 {
    let of = |numeric: &Numeric| {
        // A square root has lost half as many digits.
        if numeric.form.is_root() { numeric.weakest.sqrt() } else { numeric.weakest }
    };
    children.iter().map(|(_, numeric)| of(numeric)).fold(1.0, f64::min)
}

struct Eliminate<'a> {
    system: &'a System<'a>,
    structure: &'a Structure,
    children: &'a [(&'a Structure, &'a Numeric)],
    weakest: f64,
    data: &'a mut [f64],
    workspace: &'a mut Workspace,
}

impl WithSimd for Eliminate<'_> {
    type Output = Result<f64, BadPivot>;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> Self::Output {
        let Self { system, structure, children, weakest, data, workspace } = self;
        let layout = structure.layout();
        workspace.place(system, structure);
        workspace.locate_columns(layout, layout.panel_len());
        assemble(system, structure, children, 0, data, workspace);
        if let Some(damping) = system.damping {
            let scalars = structure.frontals.iter().flat_map(|&v| system.graph.tangent_range(v));
            for (j, scalar) in scalars.enumerate() {
                data[j * layout.rows() + j] += damping[scalar];
                workspace.diagonal[j] += damping[scalar];
            }
        }
        workspace.clock.lap(Phase::Assemble);
        let (panel, rest) = data.split_at_mut(layout.panel_len());
        let (triangle, diagonal) = rest.split_at_mut(layout.triangle_len());
        diagonal.copy_from_slice(&workspace.diagonal[layout.frontal()..]);
        let bound = PivotBound { ratio: CHOLESKY_PIVOT, product: CHOLESKY_PRODUCT, weakest };
        let front =
            PartialCholesky { layout, panel, triangle, diagonal: &workspace.diagonal, bound };
        let ratio = partial_cholesky(simd, front, &mut workspace.square);
        workspace.clock.lap(Phase::Eliminate);
        ratio
    }
}

struct Contribute<'a> {
    system: &'a System<'a>,
    structure: &'a Structure,
    children: &'a [(&'a Structure, &'a Numeric)],
    panel: &'a [f64],
    data: &'a mut [f64],
    workspace: &'a mut Workspace,
}

impl WithSimd for Contribute<'_> {
    /// The smallest pivot ratio of the first frontals.
    type Output = f64;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> f64 {
        let Self { system, structure, children, panel, data, workspace } = self;
        let layout = structure.layout();
        workspace.place(system, structure);
        workspace.locate_columns(layout, 0);
        assemble(system, structure, children, layout.frontal(), data, workspace);
        workspace.clock.lap(Phase::Assemble);
        let (triangle, diagonal) = data.split_at_mut(layout.triangle_len());
        diagonal.copy_from_slice(&workspace.diagonal[layout.frontal()..]);
        SubtractOuter { layout, panel, triangle }.with_simd(simd);
        workspace.clock.lap(Phase::Eliminate);
        let ratio = |j: usize| panel[j * layout.rows() + j].powi(2) / workspace.diagonal[j];
        (0..layout.frontal()).map(ratio).fold(f64::INFINITY, f64::min)
    }
}

/// Adds factors and children to the columns from `first` on, and to the diagonal.
#[inline(always)]
fn assemble(
    system: &System<'_>,
    structure: &Structure,
    children: &[(&Structure, &Numeric)],
    first: usize,
    data: &mut [f64],
    workspace: &mut Workspace,
) {
    let columns = structure.layout().columns();
    for &factor in &structure.factors {
        let mut target = Assembly {
            data: &mut *data,
            base: &workspace.base,
            diagonal: &mut workspace.diagonal,
            first,
        };
        add_factor(system, factor, columns, &workspace.place, &mut target);
    }
    for (child, numeric) in children {
        workspace.map_child(child, columns);
        let mut target = Assembly {
            data: &mut *data,
            base: &workspace.base,
            diagonal: &mut workspace.diagonal,
            first,
        };
        add_contribution(numeric, &workspace.runs, &mut target);
    }
}
