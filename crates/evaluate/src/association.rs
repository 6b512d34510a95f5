//! Which estimated pose belongs to which true one.

use std::fmt;

use evergraph_formats::Trajectory;
use evergraph_model::Pose3;

use crate::EvaluateError;

/// What an estimated pose and its true pose have in common.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub enum Association {
    /// The same id.
    Id,
    /// The nearest time; where a trajectory has no times, a pose's id as a number stands for it, as
    /// in a TUM file written without times.
    Time {
        /// Largest difference (s).
        max_difference: f64,
    },
}

impl Association {
    /// By time, to 0.01 s.
    pub const TIME: Self = Self::Time { max_difference: 0.01 };

    /// How these two are associated unless somebody says otherwise: by id where both have ids, since
    /// several robots may have poses of the same time; else by [`TIME`](Self::TIME).
    pub fn of(estimate: &Trajectory, truth: &Trajectory) -> Self {
        if estimate.ids().is_some() && truth.ids().is_some() { Self::Id } else { Self::TIME }
    }
}

impl fmt::Display for Association {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Id => f.write_str("id"),
            Self::Time { max_difference } => write!(f, "time to {max_difference} s"),
        }
    }
}

/// A pose, estimated and true.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct PosePair {
    /// Its id, where one is known.
    pub id: Option<u64>,
    /// Its time in the estimate, where that is known (s).
    pub time: Option<f64>,
    /// Where the estimate has it, `world_from_robot`.
    pub estimate: Pose3,
    /// Where it was, `world_from_robot`.
    pub truth: Pose3,
}

/// The poses that a truth is known for, in the order of the estimate.
#[derive(Clone, Debug, PartialEq)]
pub struct PosePairs {
    pairs: Vec<PosePair>,
    planar: bool,
}

impl PosePairs {
    /// Finds the partners.
    ///
    /// By time, each pose of the trajectory with fewer poses (the truth, if they are equal) takes
    /// the nearest one of the other, the earlier of two that are equally near; a pose of the longer
    /// one may serve twice. This is what evo does.
    ///
    /// # Errors
    /// [`EvaluateError::PlaneAgainstSpace`], [`EvaluateError::TimesAgainstIds`] where only one side has
    /// times and these are no whole numbers, [`EvaluateError::NoMatch`], [`EvaluateError::NoIds`], [`EvaluateError::BadSetting`] for a
    /// difference that is negative or no number.
    pub fn new(
        estimate: &Trajectory,
        truth: &Trajectory,
        association: Association,
    ) -> Result<Self, EvaluateError> {
        for (planar, spatial) in [(estimate, truth), (truth, estimate)] {
            if planar.is_of_plane() && !spatial.is_planar() {
                return Err(EvaluateError::PlaneAgainstSpace {
                    planar: planar.name().into(),
                    spatial: spatial.name().into(),
                });
            }
        }
        let mut matches = match association {
            Association::Id => by_id(estimate, truth)?,
            Association::Time { max_difference } => {
                if max_difference.is_nan() || max_difference < 0.0 {
                    let (setting, demand) = ("largest difference of time", "at least 0");
                    return Err(EvaluateError::BadSetting {
                        setting,
                        value: max_difference,
                        demand,
                    });
                }
                check_times(estimate, truth)?;
                if truth.len() > estimate.len() {
                    by_time(estimate, truth, max_difference)
                } else {
                    let found = by_time(truth, estimate, max_difference);
                    found.into_iter().map(|(truth, estimate)| (estimate, truth)).collect()
                }
            }
        };
        if matches.is_empty() {
            return Err(EvaluateError::NoMatch {
                estimate: estimate.name().into(),
                truth: truth.name().into(),
                by: association.to_string(),
            });
        }
        matches.sort_unstable();
        let pair = |&(e, t): &(usize, usize)| PosePair {
            id: estimate.ids().map(|ids| ids[e]).or(truth.ids().map(|ids| ids[t])),
            time: estimate.times().map(|times| times[e]),
            estimate: estimate.poses()[e],
            truth: truth.poses()[t],
        };
        Ok(Self {
            pairs: matches.iter().map(pair).collect(),
            planar: estimate.is_planar() && truth.is_planar(),
        })
    }

    /// The pairs; at least one.
    pub fn pairs(&self) -> &[PosePair] {
        &self.pairs
    }

    /// Whether both trajectories lie in the plane: see [`Trajectory::is_planar`].
    pub fn is_planar(&self) -> bool {
        self.planar
    }
}

/// Ids may stand for times only beside whole numbers, as in a TUM file written without times.
fn check_times(estimate: &Trajectory, truth: &Trajectory) -> Result<(), EvaluateError> {
    for (timed, numbered) in [(estimate, truth), (truth, estimate)] {
        let times = timed.times().unwrap_or_default();
        if numbered.times().is_none() && times.iter().any(|time| time.fract() != 0.0) {
            return Err(EvaluateError::TimesAgainstIds {
                timed: timed.name().into(),
                numbered: numbered.name().into(),
            });
        }
    }
    Ok(())
}

/// Indices in both of the ids that both have.
fn by_id(estimate: &Trajectory, truth: &Trajectory) -> Result<Vec<(usize, usize)>, EvaluateError> {
    let sorted = |trajectory: &Trajectory| {
        let no_ids = || EvaluateError::NoIds { name: trajectory.name().into() };
        let ids = trajectory.ids().ok_or_else(no_ids)?;
        let mut order: Vec<(u64, usize)> = ids.iter().copied().zip(0..).collect();
        order.sort_unstable();
        Ok::<_, EvaluateError>(order)
    };
    let (estimate, truth) = (sorted(estimate)?, sorted(truth)?);
    let partner = |&(id, at): &(u64, usize)| {
        let place = truth.binary_search_by_key(&id, |entry| entry.0).ok()?;
        Some((at, truth[place].1))
    };
    Ok(estimate.iter().filter_map(partner).collect())
}

/// For each pose of `short` the nearest one of `long`, where it is near enough.
fn by_time(short: &Trajectory, long: &Trajectory, max_difference: f64) -> Vec<(usize, usize)> {
    let times: Vec<f64> = (0..long.len()).map(|k| long.time_or_id(k)).collect();
    let partner = |at: usize| {
        let time = short.time_or_id(at);
        let later = times.partition_point(|&other| other <= time);
        let earlier = later.checked_sub(1);
        let difference = |place: usize| (times[place] - time).abs();
        let nearest = match (earlier, (later < times.len()).then_some(later)) {
            (Some(a), Some(b)) if difference(b) < difference(a) => b,
            (Some(a), _) => a,
            (None, b) => b?,
        };
        (difference(nearest) <= max_difference).then_some((at, nearest))
    };
    (0..short.len()).filter_map(partner).collect()
}
