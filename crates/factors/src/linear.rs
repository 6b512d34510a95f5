//! Generic linear constraints: what node removal leaves behind.

use std::any::Any;

use evergraph_model::{Arguments, Factor, Linearization, Value, VariableId, VariableType};
use nalgebra::{DMatrix, DVector};
use smallvec::SmallVec;

use crate::error::{FactorError, finite};
use crate::root_shift::{Buffer, Chart, RootShift, coordinates};

/// A linear factor on any number of variables of any types (GLC):
///
/// ```text
/// e = G (Local(x̂', r(x)) - d')
/// ```
///
/// `r` is the root shift (equation 5 of the paper), `x̂' = r(x̂)` the coordinates at the
/// linearization point, `Local` is taken coordinate by coordinate, `G` is `q × p` with
/// `GᵀG = Λ'` the information in those coordinates (equations 6 and 9), of any rank, and `d'` of
/// length `p` is the offset (in the paper zero: the measurement is the linearization point). The
/// residual is whitened as it stands.
///
/// Columns of `G` follow the variables, each in the order of its tangent. With `cₖ` the
/// coordinates and `lₖ = Local(ĉₖ, cₖ)`, the Jacobian holds away from the linearization point too:
/// `Gₖ Jr⁻¹(lₖ)` for the coordinate's own variable, and `-Gₖ Jr⁻¹(lₖ) Ad(cₖ⁻¹)` for the root; of a
/// point that is seen from it `Gₖ C₁ᵀ` and `-Gₖ [I -[cₖ]×]`.
/// Variables of types from outside this library have the derivative of their `Local` taken
/// numerically.
///
/// Reference: Carlevaris-Bianco and Eustice, "Long-Term Simultaneous Localization and Mapping with
/// Generic Linear Constraint Node Removal" (2013), section II.
#[derive(Clone, Debug)]
pub struct Linear {
    keys: SmallVec<[VariableId; 4]>,
    linearization_points: Vec<Value>,
    /// x̂' = r(x̂).
    coordinates: Vec<Value>,
    charts: Vec<Chart>,
    /// First column of G of each variable, and their number at the end.
    columns: SmallVec<[usize; 5]>,
    root_shift: RootShift,
    sqrt_information: DMatrix<f64>,
    offset: DVector<f64>,
}

/// A small matrix or vector of one variable.
type Block = SmallVec<[f64; 36]>;

impl Linear {
    /// A linear factor on `variables`, given with their linearization points.
    ///
    /// # Errors
    /// [`FactorError::Shape`] when `sqrt_information` or `offset` do not fit the sum of the
    /// variables' dimensions, or there is no variable or row; [`FactorError::RootIsNoPose`];
    /// [`FactorError::NotFinite`].
    pub fn new(
        variables: &[(VariableId, Value)],
        root_shift: RootShift,
        sqrt_information: DMatrix<f64>,
        offset: DVector<f64>,
    ) -> Result<Self, FactorError> {
        let shape = |what, unit, expected, actual| {
            if expected == actual {
                Ok(())
            } else {
                Err(FactorError::Shape { what, unit, expected, actual })
            }
        };
        let linearization_points: Vec<Value> =
            variables.iter().map(|(_, value)| value.clone()).collect();
        for point in &linearization_points {
            finite("Linear", "linearization point", point.storage())?;
        }
        let mut columns = SmallVec::from_slice(&[0]);
        columns.extend(linearization_points.iter().scan(0, |end, value| {
            *end += value.dim();
            Some(*end)
        }));
        let width = columns[variables.len()];
        shape("variable list", "variables", variables.len().max(1), variables.len())?;
        shape("square-root information", "columns", width, sqrt_information.ncols())?;
        let rows = sqrt_information.nrows();
        shape("square-root information", "rows", rows.max(1), rows)?;
        shape("offset", "entries", width, offset.len())?;
        finite("Linear", "square-root information", sqrt_information.as_slice())?;
        finite("Linear", "offset", offset.as_slice())?;
        let (charts, coordinates) = coordinates(root_shift, &linearization_points)?;
        Ok(Self {
            keys: variables.iter().map(|(id, _)| *id).collect(),
            linearization_points,
            coordinates,
            charts,
            columns,
            root_shift,
            sqrt_information,
            offset,
        })
    }

    /// `x̂`, one value per key.
    pub fn linearization_points(&self) -> &[Value] {
        &self.linearization_points
    }

    /// The coordinates that it is linear in.
    pub fn root_shift(&self) -> RootShift {
        self.root_shift
    }

    /// `G`; with it the noise is that of unit information.
    pub fn sqrt_information(&self) -> &DMatrix<f64> {
        &self.sqrt_information
    }

    /// `d'`.
    pub fn offset(&self) -> &DVector<f64> {
        &self.offset
    }

    fn dim(&self, k: usize) -> usize {
        self.columns[k + 1] - self.columns[k]
    }

    /// `out += sign Gₖ m` for a column-major `m` with as many rows as variable `k` has dimensions.
    fn add_product(&self, k: usize, m: &[f64], sign: f64, out: &mut [f64]) {
        let rows = self.sqrt_information.nrows();
        let g =
            &self.sqrt_information.as_slice()[rows * self.columns[k]..rows * self.columns[k + 1]];
        for (m, out) in m.chunks_exact(self.dim(k)).zip(out.chunks_exact_mut(rows)) {
            for (&factor, g) in m.iter().zip(g.chunks_exact(rows)) {
                out.iter_mut().zip(g).for_each(|(out, g)| *out += sign * factor * g);
            }
        }
    }

    /// `out += Gₖ (lₖ - d'ₖ)`.
    fn add_residual(&self, k: usize, local: &[f64], out: &mut [f64]) {
        let offset = &self.offset.as_slice()[self.columns[k]..self.columns[k + 1]];
        let difference: Block = local.iter().zip(offset).map(|(l, d)| l - d).collect();
        self.add_product(k, &difference, 1.0, out);
    }

    /// The coordinate of variable `k` at `at`, and `Local` to it from the linearization point.
    fn local<'b>(
        &self,
        k: usize,
        at: &Arguments<'b>,
        buffer: &'b mut Buffer,
    ) -> (&'b [f64], Block) {
        let coordinate = self.charts[k].coordinate(at.storage(0), at.storage(k), buffer);
        let mut local = Block::from_elem(0.0, self.dim(k));
        self.coordinates[k].kind().local(self.coordinates[k].storage(), coordinate, &mut local);
        (coordinate, local)
    }
}

impl Factor for Linear {
    fn name(&self) -> String {
        "Linear".into()
    }

    fn keys(&self) -> &[VariableId] {
        &self.keys
    }

    fn residual_dim(&self) -> usize {
        self.sqrt_information.nrows()
    }

    fn accepts(&self, position: usize, kind: &VariableType, dim: usize) -> bool {
        let point = self.linearization_points.get(position);
        point.is_some_and(|point| point.kind() == kind && point.dim() == dim)
    }

    fn residual(&self, at: &Arguments<'_>, out: &mut [f64]) {
        out.fill(0.0);
        for k in 0..self.keys.len() {
            let mut buffer = Buffer::new();
            let (_, local) = self.local(k, at, &mut buffer);
            self.add_residual(k, &local, out);
        }
    }

    fn linearize(&self, at: &Arguments<'_>, out: &mut Linearization<'_>) {
        for k in 0..self.keys.len() {
            let mut buffer = Buffer::new();
            let (coordinate, local) = self.local(k, at, &mut buffer);
            self.add_residual(k, &local, out.residual_mut());
            let dim = self.dim(k);
            let mut jacobian = Block::from_elem(0.0, dim * dim);
            self.charts[k].local_jacobian(&self.coordinates[k], coordinate, &local, &mut jacobian);
            if self.charts[k].follows_the_root() {
                let mut by_root = Block::from_elem(0.0, dim * self.dim(0));
                self.charts[k].transport(at.storage(0), coordinate, &jacobian, &mut by_root);
                self.add_product(k, &by_root, -1.0, out.block_mut(0));
            }
            if self.charts[k].follows_its_variable() {
                self.charts[k].turn(at.storage(0), at.storage(k), &mut jacobian);
                self.add_product(k, &jacobian, 1.0, out.block_mut(k));
            }
        }
    }

    fn as_any(&self) -> &dyn Any {
        self
    }
}
