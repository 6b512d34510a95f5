//! Marginals of a target over some of its members.

use nalgebra::DMatrix;

use crate::rank_qr::echelon;
use crate::target::Target;

/// The square root of a marginal, which further marginals can be taken of.
struct Marginal {
    members: Vec<usize>,
    /// Columns of the members in that order.
    rows: DMatrix<f64>,
}

impl Target {
    /// The square root of the marginal of `Λ_t` over the members `kept`, columns in that order: all
    /// others eliminated. O(n³) in the dimension of the blanket.
    pub(crate) fn marginal(&self, kept: &[usize]) -> DMatrix<f64> {
        self.whole().onto(self, kept).rows
    }

    /// [`marginal`](Self::marginal) over each of some small sets.
    ///
    /// What no set of the first half has is eliminated once for that half, and so on down, so that
    /// all edges of a tree together take O(n³), as one of them does.
    pub(crate) fn marginals<S: AsRef<[usize]>>(&self, sets: &[S]) -> Vec<DMatrix<f64>> {
        let mut found = Vec::with_capacity(sets.len());
        self.whole().halve(self, sets, &mut found);
        found
    }

    /// Brings rows in the columns of one member into echelon form; their number is then their rank.
    pub(crate) fn reduced(&self, member: usize, mut rows: DMatrix<f64>) -> DMatrix<f64> {
        let n = rows.ncols();
        let rank = echelon(&mut rows, n, &self.scales[self.columns(member)]).len();
        rows.rows(0, rank).into_owned()
    }

    fn whole(&self) -> Marginal {
        Marginal { members: (0..self.members.len()).collect(), rows: self.root.clone() }
    }
}

impl Marginal {
    fn halve<S: AsRef<[usize]>>(&self, target: &Target, sets: &[S], found: &mut Vec<DMatrix<f64>>) {
        match sets {
            [] => {}
            [set] => found.push(self.onto(target, set.as_ref()).rows),
            _ => {
                let (first, second) = sets.split_at(sets.len() / 2);
                for half in [first, second] {
                    let mut kept: Vec<usize> =
                        half.iter().flat_map(|set| set.as_ref()).copied().collect();
                    kept.sort_unstable();
                    kept.dedup();
                    self.onto(target, &kept).halve(target, half, found);
                }
            }
        }
    }

    /// Eliminates the members that are not `kept`.
    fn onto(&self, target: &Target, kept: &[usize]) -> Self {
        let others: Vec<usize> =
            self.members.iter().copied().filter(|m| !kept.contains(m)).collect();
        let order = || others.iter().chain(kept).copied();
        let mut stack = self.select(target, order());
        let scales: Vec<f64> =
            order().flat_map(|m| &target.scales[target.columns(m)]).copied().collect();
        let width: usize = others.iter().map(|&m| target.dim_of(m)).sum();
        let rank = echelon(&mut stack, width, &scales).len();
        let (height, columns) = (stack.nrows() - rank, stack.ncols() - width);
        let rows = stack.view((rank, width), (height, columns)).into_owned();
        Self { members: kept.to_vec(), rows }
    }

    /// The columns of some members side by side.
    fn select(&self, target: &Target, order: impl Iterator<Item = usize>) -> DMatrix<f64> {
        let mut starts = vec![usize::MAX; target.members.len()];
        let mut end = 0;
        for &member in &self.members {
            starts[member] = end;
            end += target.dim_of(member);
        }
        let height = self.rows.nrows();
        let mut data = Vec::with_capacity(self.rows.len());
        for member in order {
            let columns = starts[member]..starts[member] + target.dim_of(member);
            data.extend_from_slice(
                &self.rows.as_slice()[columns.start * height..columns.end * height],
            );
        }
        let width = data.len().checked_div(height).unwrap_or(end);
        DMatrix::from_vec(height, width, data)
    }
}

#[cfg(test)]
mod tests {
    use evergraph_model::{Graph, Point2, Value};
    use nalgebra::DVector;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::*;
    use crate::member::Member;
    use crate::rank_qr::column_norms;

    /// A target of given rank on points of the plane.
    fn target(members: usize, rank: usize, rng: &mut ChaCha8Rng) -> Target {
        let n = 2 * members;
        let mut root = DMatrix::from_fn(rank, n, |_, _| rng.random_range(-1.0..1.0));
        let scales = column_norms(&root, n);
        let pivots = echelon(&mut root, n, &scales);
        let mut change = Graph::new().change();
        let mut member = || {
            let value = Value::new(&Point2::new(0.0, 0.0));
            Member::at(change.add_value(value.clone()), value)
        };
        Target {
            members: (0..members).map(|_| member()).collect(),
            offsets: (0..=members).map(|k| 2 * k).collect(),
            rhs: DVector::zeros(rank),
            root,
            pivots,
            scales,
            held: Vec::new(),
            explained: 0.0,
            free: 0,
            inverse: std::cell::OnceCell::new(),
        }
    }

    /// Whatever the order of the edges and the rank of the target, halving gives the marginals that
    /// are had one by one.
    #[test]
    fn marginals_of_many_are_those_of_each() {
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        for (members, rank) in [(2, 4), (5, 10), (9, 18), (9, 11), (16, 20), (16, 3)] {
            let target = target(members, rank, &mut rng);
            let edges: Vec<[usize; 2]> =
                (1..members).map(|k| [k, rng.random_range(0..k)]).rev().collect();
            for (edge, rows) in edges.iter().zip(target.marginals(&edges)) {
                let own = target.marginal(edge);
                assert!((own.tr_mul(&own) - rows.tr_mul(&rows)).amax() < 1e-10, "{members} {rank}");
            }
        }
        assert!(target(3, 6, &mut rng).marginals::<[usize; 2]>(&[]).is_empty());
    }
}
