//! What to put in the place of a removed node.

use evergraph_factors::{Linear, RootShift};
use evergraph_model::Factor;
use serde::{Deserialize, Serialize};

use crate::error::RemovalError;

/// Which of the blanket's variables the new factors join.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum Topology {
    /// A dense factor on blankets of up to [`Options::dense_up_to`] variables where a tree would lose anything worth it, a
    /// tree elsewhere.
    ///
    /// On a blanket of n variables a dense factor joins `(n - 1)(n - 2) / 2` pairs that a tree does not join. The tree
    /// stays when its divergence from the target is below 0.001 nats for each of them. Between two variables both are
    /// the same. With [`Recovery::Nonlinear`] the tree is taken, because a dense factor is no ordinary edge.
    #[default]
    Auto,
    /// One factor on the whole blanket: exact, and in the long run a dense graph.
    Dense,
    /// The spanning tree of most mutual information (Chow and Liu): the closest of all trees, with
    /// [`MutualInformation::Limit`].
    ChowLiu,
}

/// Bounds on the information of new factors.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum Consistency {
    /// None: least divergence. A tree claims too much in some directions and too little in others.
    #[default]
    None,
    /// `Λ' ≤ Λ_t` in the Loewner order, at the linearization point: new factors claim no more than the factors that
    /// they replace in any direction, and of all such information on the tree this has the least divergence. The map
    /// after is then never more certain than the map before. Costs a small convex program for each tree.
    Conservative,
    /// The same bound by a common factor on the tree's information. Loses more; for comparison.
    Scaled,
}

/// What kind of factors carry the information.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum Recovery {
    /// Generic linear constraints: any types, any rank.
    #[default]
    Glc,
    /// Ordinary factors (relative poses, points seen from poses, priors), which are linearized
    /// again as the estimate moves and which files of every dialect can hold. What has no such
    /// form becomes a generic linear constraint: a clique of three or more with
    /// [`Topology::Dense`], and what falls back to that.
    Nonlinear,
    /// Measurements compounded along two edges and merged: what pruning did before generic linear
    /// constraints. Double counts; for comparison. Full relative poses on trees only.
    Composition,
    /// Nothing: what the node's factors said of other variables is *lost*. By this name only.
    Drop,
}

impl Recovery {
    /// True if a new unary term can be merged with this factor, because both have one form.
    pub(crate) fn merges(self, factor: &dyn Factor) -> bool {
        matches!(factor.downcast::<Linear>(), Some((_, None)))
            || self == Self::Nonlinear && factor.name().starts_with("Prior<")
    }
}

/// Where the new factors have their minimum.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum Offset {
    /// The gradient of the new factors at the estimate is that of the factors they replace, so
    /// that removal at the optimum moves nothing.
    #[default]
    KeepGradient,
    /// At the estimate, as in the GLC paper (equation 9 with the measurement at the linearization
    /// point). Drops that gradient, and so shifts the map.
    Zero,
}

/// What the Chow-Liu tree maximizes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum MutualInformation {
    /// Equation 17 of the laser paper, and where the target is singular its limit under a
    /// vanishing prior. Where all is relative and otherwise known that is `½ ln det Λ` with Λ the
    /// information of one variable as seen from the other.
    Limit,
    /// `½ (ln det(Λ_i|j + I) - ln det(Λ_i + I))`, as iSAM 1.7 has it: defined for singular targets,
    /// and depends on units.
    LogDetPlusIdentity,
    /// [`MutualInformation::Limit`], but `½ ln det(Λ + 1e-4 D)` where all is relative and otherwise
    /// known, D the mean of the diagonal of Λ over translations and over rotations.
    ///
    /// Directions of which a pair knows far less than of others, sideways at the end of a long lever for
    /// one, count for less. iSAM's `+ I` does the like in units of 1 m and 1 rad; this has no units, and
    /// does not depend on how axes are turned.
    #[default]
    Damped,
}

/// Which directions of a generic linear constraint count as information.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum Rank {
    /// Those that the column-scaled Jacobian shows, 1e-10 of a column's norm or more.
    #[default]
    Relative,
    /// Eigenvalues of `Λ'` above this times its dimension, as iSAM 1.7 has it with 1e-8: depends on
    /// units.
    Absolute(f64),
}

/// How far the minimum of a new factor may lie from the estimate before a tree is not trusted and
/// the clique takes the dense form.
///
/// Offsets are small at first and grow when nodes are removed again and again. Where a tree is what one
/// factor would be, between two, there is nothing to guard against.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
#[non_exhaustive]
pub struct Guard {
    /// Rotation of an offset, radians. Directions in which the factor knows less than a prior of
    /// 1 m or 1 rad would do not count: a minimum far out there pulls as hardly as it is known.
    /// Default 1.
    pub rotation: f64,
    /// Length of a factor's whitened residual at the estimate, standard deviations. Default 100.
    pub mahalanobis: f64,
    /// Most variables of a blanket that one factor may replace where the tree's offset is beyond the limits
    /// above. On a larger blanket the tree stays, with its offset shortened to the limits: all later
    /// removals nearby would pay for a large clique, and the next ones would be larger. Default 16.
    pub largest_dense: usize,
}

impl Guard {
    /// Sets [`rotation`](Self::rotation).
    #[must_use]
    pub fn with_rotation(self, rotation: f64) -> Self {
        Self { rotation, ..self }
    }

    /// Sets [`largest_dense`](Self::largest_dense).
    #[must_use]
    pub fn with_largest_dense(self, variables: usize) -> Self {
        Self { largest_dense: variables, ..self }
    }

    /// Sets [`mahalanobis`](Self::mahalanobis).
    #[must_use]
    pub fn with_mahalanobis(self, mahalanobis: f64) -> Self {
        Self { mahalanobis, ..self }
    }
}

impl Default for Guard {
    fn default() -> Self {
        Self { rotation: 1.0, mahalanobis: 100.0, largest_dense: 16 }
    }
}

/// How nodes are removed.
///
/// The default is made for robots that map for years: dense factors where they are small enough for what a tree would
/// lose, trees elsewhere ([`Topology::Auto`]), generic linear constraints, which exist for every type and rank, and the
/// gradient kept, so that removal moves nothing.
///
/// Options can be read from partial data; a name that is no field is refused.
///
/// ```
/// use evergraph_removal::{Guard, Options, Recovery};
///
/// let options = Options::dense()
///     .with_recovery(Recovery::Nonlinear)
///     .with_guard(Guard::default().with_rotation(0.5));
/// let read: Options = serde_json::from_str(
///     r#"{"topology": "dense", "recovery": "nonlinear", "guard": {"rotation": 0.5}}"#,
/// )?;
/// assert_eq!(read, options);
/// assert!(serde_json::from_str::<Options>(r#"{"topolgy": "dense"}"#).is_err());
/// # Ok::<(), serde_json::Error>(())
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
#[non_exhaustive]
pub struct Options {
    /// Default [`Topology::Auto`].
    pub topology: Topology,
    /// With [`Topology::Auto`], the most variables of a blanket that one dense factor may join. Default 10: half of the
    /// loss of trees or less, at 10 to 40 % more fill of the factorization (docs/removal.md). In a window of fixed lag
    /// the number of poses in the window keeps removal exact.
    pub dense_up_to: usize,
    /// Default [`Consistency::None`].
    pub consistency: Consistency,
    /// Default [`Recovery::Glc`].
    pub recovery: Recovery,
    /// Default [`Offset::KeepGradient`].
    pub offset: Offset,
    /// The coordinates in which linear factors of a pose with other poses or points are linear.
    /// Default [`RootShift::Root`], which needs them to be known relative to each other only.
    pub root_shift: RootShift,
    /// Default [`MutualInformation::Damped`].
    pub mutual_information: MutualInformation,
    /// Default [`Rank::Relative`].
    pub rank: Rank,
    /// Whether factors between variables of the blanket that are not on the node are replaced too,
    /// as the papers do: the tree then stands for all that the clique knows, and edges between kept
    /// neighbours do not pile up. `false` leaves them alone. Default `true`.
    pub intra_clique: bool,
    /// Whether factors on a single kept variable are left alone, and the unary factor of a tree is on the variable of its
    /// blanket that was added last, merged with those that removals have put there before. `false` absorbs them like all
    /// factors inside the blanket, as the papers do: what is known of the world is then approximated anew with each
    /// removal nearby, and drifts. Default `true`.
    pub keep_unary: bool,
    /// A robust factor of less weight than this where it is linearized (by more than rounding) is not
    /// absorbed: between kept variables it stays, on the node it goes without a trace (the plan lists
    /// it). At 1 only factors that their kernel leaves whole are absorbed. Default 0.01.
    pub least_weight: f64,
    /// When a tree is not trusted.
    pub guard: Guard,
    /// Where an estimate is no further than this (metres, radians, of each component) from its
    /// linearization point, the removal takes the variable as it is in the linear model that the smoother
    /// has solved; where it takes the node and all of the blanket like that, nothing else moves, not even by
    /// a second-order term. Further away the factors are linearized at the estimate. Default 0.01: the
    /// square of it over two, 5e-5 for each metre to a neighbour, is what the linear model leaves out at
    /// most. See [`Estimates::linearized`](crate::Estimates::linearized).
    pub linear_within: f64,
    /// A blanket of more tangent dimensions than this is refused: planning is cubic in it. A
    /// beacon that is heard from all of a map has one. Default 1000.
    pub largest_blanket: usize,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            topology: Topology::default(),
            dense_up_to: 10,
            consistency: Consistency::default(),
            recovery: Recovery::default(),
            offset: Offset::default(),
            root_shift: RootShift::Root,
            mutual_information: MutualInformation::default(),
            rank: Rank::default(),
            intra_clique: true,
            keep_unary: true,
            least_weight: 0.01,
            guard: Guard::default(),
            linear_within: 0.01,
            largest_blanket: 1000,
        }
    }
}

impl Options {
    /// The exact removal: one factor per blanket, no tree.
    #[must_use]
    pub fn dense() -> Self {
        Self { topology: Topology::Dense, ..Self::default() }
    }

    /// Trees on all blankets: sparse however often nodes are removed nearby.
    #[must_use]
    pub fn tree() -> Self {
        Self { topology: Topology::ChowLiu, ..Self::default() }
    }

    /// Equations 1 to 9 of the GLC paper to the letter: offset zero, coordinates of equation 5, mutual
    /// information undamped.
    #[must_use]
    pub fn paper() -> Self {
        Self {
            offset: Offset::Zero,
            root_shift: RootShift::InverseRoot,
            keep_unary: false,
            topology: Topology::ChowLiu,
            mutual_information: MutualInformation::Limit,
            ..Self::default()
        }
    }

    /// iSAM 1.7's variants where they differ from the paper: the root pose itself as a coordinate,
    /// mutual information from `ln det(Λ + I)`, an absolute tolerance of 1e-8.
    #[must_use]
    pub fn isam() -> Self {
        Self {
            offset: Offset::Zero,
            root_shift: RootShift::Root,
            keep_unary: false,
            topology: Topology::ChowLiu,
            mutual_information: MutualInformation::LogDetPlusIdentity,
            rank: Rank::Absolute(1e-8),
            ..Self::default()
        }
    }

    /// Refuses values without meaning.
    pub(crate) fn check(&self) -> Result<(), RemovalError> {
        let refuse =
            |option, value, expected| Err(RemovalError::Option { option, value, expected });
        if !(0.0..=1.0).contains(&self.least_weight) {
            return refuse("least_weight", self.least_weight, "from 0 to 1");
        }
        if (self.topology, self.recovery) == (Topology::Dense, Recovery::Composition) {
            return Err(RemovalError::DenseComposition);
        }
        if self.linear_within.is_nan() || self.linear_within < 0.0 {
            return refuse("linear_within", self.linear_within, "not negative");
        }
        let guard = &self.guard;
        for (option, value) in
            [("guard.rotation", guard.rotation), ("guard.mahalanobis", guard.mahalanobis)]
        {
            if value.is_nan() || value <= 0.0 {
                return refuse(option, value, "positive; infinity switches it off");
            }
        }
        match self.rank {
            Rank::Absolute(tolerance) if !(tolerance >= 0.0 && tolerance.is_finite()) => {
                refuse("rank", tolerance, "finite and not negative")
            }
            _ => Ok(()),
        }
    }
}

/// Each field can be set in a chain that starts at a named set of options.
impl Options {
    /// Sets [`topology`](Self::topology).
    #[must_use]
    pub fn with_topology(self, topology: Topology) -> Self {
        Self { topology, ..self }
    }

    /// Sets [`dense_up_to`](Self::dense_up_to).
    #[must_use]
    pub fn with_dense_up_to(self, variables: usize) -> Self {
        Self { dense_up_to: variables, ..self }
    }

    /// Sets [`consistency`](Self::consistency).
    #[must_use]
    pub fn with_consistency(self, consistency: Consistency) -> Self {
        Self { consistency, ..self }
    }

    /// Sets [`recovery`](Self::recovery).
    #[must_use]
    pub fn with_recovery(self, recovery: Recovery) -> Self {
        Self { recovery, ..self }
    }

    /// Sets [`offset`](Self::offset).
    #[must_use]
    pub fn with_offset(self, offset: Offset) -> Self {
        Self { offset, ..self }
    }

    /// Sets [`root_shift`](Self::root_shift).
    #[must_use]
    pub fn with_root_shift(self, root_shift: RootShift) -> Self {
        Self { root_shift, ..self }
    }

    /// Sets [`mutual_information`](Self::mutual_information).
    #[must_use]
    pub fn with_mutual_information(self, mutual_information: MutualInformation) -> Self {
        Self { mutual_information, ..self }
    }

    /// Sets [`rank`](Self::rank).
    #[must_use]
    pub fn with_rank(self, rank: Rank) -> Self {
        Self { rank, ..self }
    }

    /// Sets [`intra_clique`](Self::intra_clique).
    #[must_use]
    pub fn with_intra_clique(self, intra_clique: bool) -> Self {
        Self { intra_clique, ..self }
    }

    /// Sets [`keep_unary`](Self::keep_unary).
    #[must_use]
    pub fn with_keep_unary(self, keep_unary: bool) -> Self {
        Self { keep_unary, ..self }
    }

    /// Sets [`least_weight`](Self::least_weight).
    #[must_use]
    pub fn with_least_weight(self, least_weight: f64) -> Self {
        Self { least_weight, ..self }
    }

    /// Sets [`guard`](Self::guard).
    #[must_use]
    pub fn with_guard(self, guard: Guard) -> Self {
        Self { guard, ..self }
    }

    /// Sets [`linear_within`](Self::linear_within).
    #[must_use]
    pub fn with_linear_within(self, linear_within: f64) -> Self {
        Self { linear_within, ..self }
    }

    /// Sets [`largest_blanket`](Self::largest_blanket).
    #[must_use]
    pub fn with_largest_blanket(self, largest_blanket: usize) -> Self {
        Self { largest_blanket, ..self }
    }
}
