//! What the variables of a file are.

use crate::coordinates::Kind;

/// All variables of a file, by id and whether they are poses. iSAM numbers poses and landmarks
/// apart, and so does a file that gives VERTEX lines for a pose and a landmark of the same id.
///
/// A sorted list: it takes a fraction of a hash table's memory, and ids mostly have no gaps, so that
/// they are their own index.
#[derive(Clone, Debug, Default)]
pub(crate) struct Kinds {
    /// By id, a pose before a landmark.
    sorted: Vec<(u64, Kind)>,
}

/// A use of an id: where among the lines it stands, and as what.
pub(crate) type Use = (u64, Kind, usize);

impl Kinds {
    /// The first use of each variable says what it is; `repeated` hears of the others, each with the
    /// first. `apart` says whether a pose and a landmark may have the same id.
    pub fn of(mut uses: Vec<Use>, apart: bool, mut repeated: impl FnMut(Use, Use)) -> Self {
        let class = |kind: Kind| apart && !kind.is_pose();
        uses.sort_unstable_by_key(|(id, kind, line)| (*id, class(*kind), *line, !kind.is_pose()));
        uses.dedup_by(|later, first| {
            let same = later.0 == first.0 && class(later.1) == class(first.1);
            if same {
                repeated(*later, *first);
            }
            same
        });
        // In place, and then what is not needed given back.
        let mut sorted: Vec<(u64, Kind)> =
            uses.into_iter().map(|(id, kind, _)| (id, kind)).collect();
        sorted.shrink_to_fit();
        Self { sorted }
    }

    /// What the pose, or the landmark, of an id is.
    pub fn get(&self, id: u64, is_pose: bool) -> Option<Kind> {
        let is_it = |entry: &&(u64, Kind)| entry.0 == id && entry.1.is_pose() == is_pose;
        let first = self.sorted.first()?.0;
        let direct = usize::try_from(id.checked_sub(first)?).ok();
        if let Some(entry) = direct.and_then(|at| self.sorted.get(at)).filter(is_it) {
            return Some(entry.1);
        }
        let at =
            self.sorted.binary_search_by_key(&(id, !is_pose), |(id, kind)| (*id, !kind.is_pose()));
        at.ok().map(|at| self.sorted[at].1)
    }

    /// All of them, by id, a pose before a landmark.
    pub fn as_slice(&self) -> &[(u64, Kind)] {
        &self.sorted
    }

    pub fn is_empty(&self) -> bool {
        self.sorted.is_empty()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_use_counts() {
        use Kind::{Point2, Pose2, Pose3};
        let uses =
            vec![(7, Pose2, 0), (5, Pose2, 1), (7, Point2, 2), (7, Pose3, 3), (9, Point2, 4)];
        let mut seen = Vec::new();
        let kinds = Kinds::of(uses, true, |later, first| seen.push((later.2, first.2)));
        assert_eq!(seen, [(3, 0)]);
        assert_eq!(kinds.as_slice(), [(5, Pose2), (7, Pose2), (7, Point2), (9, Point2)]);
        for (id, is_pose, kind) in [
            (5, true, Some(Pose2)),
            (7, true, Some(Pose2)),
            (7, false, Some(Point2)),
            (9, false, Some(Point2)),
            (9, true, None),
            (6, true, None),
            (4, true, None),
            (u64::MAX, true, None),
        ] {
            assert_eq!(kinds.get(id, is_pose), kind, "{id}");
        }
    }
}
