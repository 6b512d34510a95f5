//! A file as the changes that a robot would have made.

mod emit;
mod evaluate;
mod factor;
mod gather;
mod gauge;
mod geometry;
mod held;
mod numbers;
mod observation;
mod order;
mod place_landmark;
mod rigid;

use std::collections::{BTreeMap, HashMap};
use std::sync::Arc;

use evergraph_model::{Change, FactorId, Graph, Kernel, Noise, Value, VariableId};

use crate::check::slot;
use crate::document::Document;
use crate::error::{FormatError, Place};
use crate::options::Dialect;
use geometry::{Geometry, Handle};
use held::Held;
use observation::Observation;
use order::{By, Link, Node, Planned};

/// Where the start value of a new variable comes from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Initial {
    /// A pose from the current estimate of the other end of its odometry edge, a landmark from the
    /// first pose that sees it: what a robot knows at that moment.
    #[default]
    FromOdometry,
    /// The file's vertex; for a variable without one as [`FromOdometry`](Self::FromOdometry).
    FromFile,
}

/// How a document is replayed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ReplayOptions {
    /// Standard deviation of the gauge priors, in metres and radians alike; `None` adds none, and
    /// the caller has to hold the gauge. Default: 0.01, firm beside the loop closures of a file and
    /// soft enough to keep the system well scaled.
    pub prior: Option<f64>,
    /// Where start values come from. Default: odometry.
    pub initial: Initial,
    /// Put around *every* measurement between two variables that has no kernel in the file, odometry
    /// included, since which edges may be wrong is not written there. Absolute measurements (priors,
    /// positions, attitudes) stay as they are, since they may be all that holds the map, and so do
    /// linear factors, which stand for many measurements. Default: none.
    pub kernel: Option<Kernel>,
}

impl Default for ReplayOptions {
    fn default() -> Self {
        Self { prior: Some(0.01), initial: Initial::FromOdometry, kernel: None }
    }
}

/// What a step does to the map.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum StepKind {
    /// The new pose comes in by one edge (or repetitions of it) and sees only new landmarks.
    Explore,
    /// Some edge ties together what was connected before: a loop closure, a landmark seen again.
    Loop,
}

/// A prior that holds the gauge; it is none of the file's factors.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GaugePrior {
    /// The pose's id in the file.
    pub id: u64,
    /// The pose.
    pub variable: VariableId,
    /// The prior.
    pub factor: FactorId,
    /// Its standard deviation, in metres and radians.
    pub sigma: f64,
    /// How many directions of the pose it holds: all, or those that absolute measurements leave
    /// free.
    pub directions: usize,
    /// Whether a FIX line put it there.
    pub fixed: bool,
}

/// What a step's change holds.
#[derive(Clone, Debug, PartialEq)]
pub struct Step {
    /// The newest pose.
    pub pose: VariableId,
    /// What the step does to the map.
    pub kind: StepKind,
    /// Factors of the file that it adds; gauge priors are not counted.
    pub factors: usize,
    /// Variables that it adds.
    pub variables: usize,
    /// Gauge priors that it adds.
    pub gauge_priors: Vec<GaugePrior>,
}

/// The steps of a document, one new pose each.
///
/// **Order.** In a g2o file, which has no time, pose k (by id) arrives with every edge whose larger
/// pose is k. TORO and iSAM files are in time order: a step is one new pose and every line up to the
/// next new pose. Where lines have times they are sorted by them, odometry first among equals. Edges
/// to landmarks belong to their pose. A pose without an edge to a pose that is present, and not the
/// first of its connected component, is held back with its edges until an edge connects it. A linear
/// factor on poses counts as an edge if it leaves their relative poses no freedom. Any other
/// measurement, of one variable or of several, brings none in: it comes with the last of them.
/// Landmarks that nothing measures are left out.
///
/// Poses that only such measurements or landmarks tie to the rest come last, a step for each part
/// that is tied together by edges between poses. A part that what is there does not determine comes
/// with the next ones, as many as it takes.
///
/// **Landmarks without a sighting.** A landmark that is not seen in full from any pose, but by
/// bearings or ranges, is held back ([`held_back`](Self::held_back)) until its measurements, taken
/// from where the poses are estimated, place it: its largest standard deviation is below 0.3 of the
/// distance to the nearest pose that sees it (parallax), the fit is plausible (residuals up to five
/// times their noise, which then counts as that much larger), and no other place fits as well (chi2
/// within 9: ranges from along a line fit two). Then it comes in, there, with all of its
/// measurements. One that is measured outright, by bearing and range, by a prior or from another
/// landmark, comes in at once.
///
/// **Start values.** A pose starts from the current estimate of the other end of its odometry edge:
/// the one to the pose just before it, or to the latest earlier pose that is present, in either
/// direction. The first pose of a part starts at its vertex or at the origin; then the part is moved
/// as a whole to where its measurements of the world and of what is there fit best.
///
/// **Gauge.** The first pose of each connected component gets a prior at its vertex, or at the
/// origin if it has none. FIX moves it: the component then begins with a fixed pose, and every
/// fixed pose gets a prior at its vertex. Where absolute measurements hold a component there is
/// none, and where they hold it in part the prior is for the other directions. A direction counts as
/// held when it is known to 1000 m or 0.5 rad. Until what is held in the end is held, the steps of
/// the component come as one: a robot that only knows its positions has no heading before it moves.
///
/// ```
/// use evergraph_formats::{Document, ReadOptions, Replay, ReplayOptions};
/// use evergraph_model::{Graph, Value, VariableId};
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// let text = "EDGE_SE2 0 1 1 0 0 100 0 0 100 0 400\nEDGE_SE2 1 2 1 0 0 100 0 0 100 0 400\n";
/// let document = Document::parse("three poses", text.as_bytes(), &ReadOptions::default())?;
/// let mut replay = Replay::new(&document, &ReplayOptions::default())?;
/// let mut graph = Graph::new();
/// let mut estimates: Vec<(VariableId, Value)> = Vec::new();
/// loop {
///     let mut change = graph.change();
///     let mut estimate = |id| estimates.iter().find(|e| e.0 == id).map(|e| e.1.clone());
///     let Some(step) = replay.next_step(&mut change, &mut estimate) else { break };
///     println!("{:?}", step?.kind);
///     // A smoother would apply the change and improve the estimate; here start values do.
///     estimates.extend(change.new_variables().iter().cloned());
///     let staged = graph.stage(&change)?;
///     graph.commit(staged);
/// }
/// assert_eq!((replay.len(), graph.variable_count(), graph.factor_count()), (3, 3, 3));
/// # Ok(())
/// # }
/// ```
#[derive(Debug)]
pub struct Replay {
    name: Arc<str>,
    options: ReplayOptions,
    nodes: Vec<Node>,
    vertices: Vec<Option<Geometry>>,
    fixed: Vec<bool>,
    /// Where each variable stands among the nodes, by id and whether it is a pose.
    places: HashMap<(u64, bool), usize>,
    links: Vec<Link>,
    /// What each link is.
    observations: Vec<Observation>,
    /// The connected component of each node, named by one of its members.
    component: Vec<usize>,
    /// Landmarks whose place a prior gives, and nothing else does.
    anchors: Vec<Option<Geometry>>,
    /// Variables of no graph, to evaluate factors on.
    scratch: Vec<Handle>,
    steps: Vec<Planned>,
    next: usize,
    handles: Vec<Option<Handle>>,
    /// Where each variable stands in `order`, and its start value.
    starts: Vec<Option<(usize, Geometry)>>,
    /// Nodes that have come in, in order.
    order: Vec<usize>,
    held: BTreeMap<usize, Held>,
    priors: Vec<GaugePrior>,
    factors: Vec<(FactorId, usize)>,
}

impl Replay {
    /// Plans the replay of a document.
    ///
    /// # Errors
    /// [`FormatError::NoPose`], [`FormatError::BadSetting`], [`FormatError::BadMeasurement`] for a
    /// matrix that overflows.
    pub fn new(document: &Document, options: &ReplayOptions) -> Result<Self, FormatError> {
        if let Some(sigma) = options.prior
            && Noise::isotropic(1, sigma).is_err()
        {
            let (setting, demand) = ("sigma of the gauge prior", "positive and finite");
            return Err(FormatError::BadSetting { setting, value: sigma, demand });
        }
        let nodes: Vec<Node> =
            document.ids().into_iter().map(|(id, kind)| Node { id, kind }).collect();
        if !nodes.iter().any(|node| node.kind.is_pose()) {
            return Err(FormatError::NoPose { file: document.name().into() });
        }
        let count = nodes.len();
        let mut scratch = Graph::new().change();
        let mut replay = Self {
            name: document.name().into(),
            options: *options,
            places: nodes
                .iter()
                .enumerate()
                .map(|(at, node)| (slot(node.id, node.kind), at))
                .collect(),
            scratch: nodes
                .iter()
                .map(|node| Geometry::origin(node.kind).add_to(&mut scratch))
                .collect(),
            nodes,
            vertices: vec![None; count],
            fixed: vec![false; count],
            links: Vec::new(),
            observations: Vec::new(),
            component: Vec::new(),
            anchors: vec![None; count],
            steps: Vec::new(),
            next: 0,
            handles: vec![None; count],
            starts: vec![None; count],
            order: Vec::with_capacity(count),
            held: BTreeMap::new(),
            priors: Vec::new(),
            factors: Vec::new(),
        };
        replay.gather(document)?;
        let has_times = replay.links.iter().any(|link| link.time.is_some());
        let by = if document.dialect() == Dialect::G2o && !has_times { By::Id } else { By::Line };
        replay.component = order::components(count, &replay.links);
        replay.steps = order::plan(&replay.nodes, &replay.links, &replay.fixed, by);
        replay.settle_gauge()?;
        Ok(replay)
    }

    /// Fills an empty `change`, made from the graph as it is now, with the next step; `None` when
    /// there is none. `estimate` gives the current estimate of a variable of an earlier step. Apply
    /// the change before asking for the next.
    ///
    /// # Errors
    /// [`FormatError::NoEstimate`], [`FormatError::StartNotFinite`],
    /// [`FormatError::BadMeasurement`]. After an error there are no more steps.
    pub fn next_step(
        &mut self,
        change: &mut Change,
        estimate: &mut dyn FnMut(VariableId) -> Option<Value>,
    ) -> Option<Result<Step, FormatError>> {
        let step = self.steps.get_mut(self.next).map(std::mem::take)?;
        self.next += 1;
        let result = self.emit(step, change, Some(estimate));
        if result.is_err() {
            self.next = self.steps.len();
        }
        Some(result)
    }

    /// Fills an empty `change` with all steps that are left: for a fresh replay the whole file, as
    /// one step. Start values are the file's vertices or composed, as [`Initial`] says, in the
    /// order of the steps.
    ///
    /// # Errors
    /// As [`next_step`](Self::next_step); [`FormatError::NoPose`] when no step is left.
    pub fn everything(&mut self, change: &mut Change) -> Result<Step, FormatError> {
        let mut whole: Option<Step> = None;
        while let Some(step) = self.steps.get_mut(self.next).map(std::mem::take) {
            self.next += 1;
            let step = self.emit(step, change, None);
            if step.is_err() {
                self.next = self.steps.len();
            }
            let step = step?;
            match &mut whole {
                None => whole = Some(step),
                Some(whole) => whole.append(step),
            }
        }
        whole.ok_or_else(|| FormatError::NoPose { file: Arc::clone(&self.name) })
    }

    fn place(&self, link: Option<usize>) -> Place {
        let line = link.and_then(|link| self.observations.get(link)).map_or(0, |seen| seen.line);
        Place { file: Arc::clone(&self.name), line }
    }

    /// How many steps there are, taken ones included: one for each pose, but that poses which no
    /// edges between poses tie to the rest come together, and so do those until absolute measurements
    /// hold them. Fewer once parts had to be joined.
    pub fn len(&self) -> usize {
        self.steps.len()
    }

    /// Whether there are no steps; never so, since a document without poses has no replay.
    pub fn is_empty(&self) -> bool {
        self.steps.is_empty()
    }

    /// The variable that came in for an id; should a pose and a landmark have the same id, the pose.
    pub fn variable(&self, id: u64) -> Option<VariableId> {
        self.pose(id).or_else(|| self.landmark(id))
    }

    /// The pose that came in for an id.
    pub fn pose(&self, id: u64) -> Option<VariableId> {
        self.handles[*self.places.get(&(id, true))?].map(Handle::id)
    }

    /// The landmark that came in for an id.
    pub fn landmark(&self, id: u64) -> Option<VariableId> {
        self.handles[*self.places.get(&(id, false))?].map(Handle::id)
    }

    /// The variables that came in, with their ids in the file, in the order of arrival.
    pub fn ids(&self) -> impl Iterator<Item = (u64, VariableId)> {
        self.order.iter().filter_map(|&node| Some((self.nodes[node].id, self.handles[node]?.id())))
    }

    /// The gauge priors so far.
    pub fn gauge_priors(&self) -> &[GaugePrior] {
        &self.priors
    }

    /// The file's factors so far, with their lines, in the order they came in.
    pub fn factors(&self) -> &[(FactorId, usize)] {
        &self.factors
    }

    /// Landmarks with a vertex that nothing measures; they are left out.
    pub fn unseen_landmarks(&self) -> usize {
        let mut seen = vec![false; self.nodes.len()];
        self.links.iter().flat_map(|link| &link.ends).for_each(|&end| seen[end] = true);
        self.nodes.iter().zip(seen).filter(|(node, seen)| !node.kind.is_pose() && !seen).count()
    }
}

impl Step {
    /// Makes one step of two in a row.
    fn append(&mut self, next: Self) {
        self.pose = next.pose;
        self.factors += next.factors;
        self.variables += next.variables;
        self.gauge_priors.extend(next.gauge_priors);
        if next.kind == StepKind::Loop {
            self.kind = StepKind::Loop;
        }
    }
}
