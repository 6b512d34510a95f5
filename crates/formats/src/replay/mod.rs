//! A file as the changes that a robot would have made.

mod emit;
mod measure;
mod order;

use std::collections::HashMap;
use std::sync::Arc;

use evergraph_model::{Change, FactorId, Kernel, Noise, Value, VariableId};

use crate::check::{bad, slot};
use crate::convert;
use crate::document::Document;
use crate::error::{FormatError, Place};
use crate::options::Dialect;
use crate::record::{Line, Record};
use measure::{Geometry, Handle, Measured};
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
    /// Put around *every* factor of the file, odometry included, since which edges may be wrong is
    /// not written there; priors stay as they are. Default: none.
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
/// next new pose. Edges to landmarks belong to their pose. A pose without an edge to a pose that is
/// present, and not the first of its connected component, is held back with its edges until an edge
/// connects it. Poses that only landmarks tie to the rest come last, a step for each part that is
/// tied together by edges between poses; they start from the vertex of the first of them, or at the
/// origin. Where such a part is only determined together with a later one, its step is refused. Landmarks that no
/// pose sees are left out.
///
/// **Start values.** A pose starts from the current estimate of the other end of its odometry edge:
/// the one to the pose just before it, or to the latest earlier pose that is present, in either
/// direction.
///
/// **Gauge.** The first pose of each connected component gets a prior at its vertex, or at the
/// origin if it has none. FIX moves it: the component then begins with a fixed pose, and every
/// fixed pose gets a prior at its vertex.
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
    edges: Vec<Measured>,
    steps: Vec<Planned>,
    next: usize,
    handles: Vec<Option<Handle>>,
    /// Where each variable stands in `order`, and its start value.
    starts: Vec<Option<(usize, Geometry)>>,
    /// Nodes that have come in, in order.
    order: Vec<usize>,
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
        let mut replay = Self {
            name: document.name().into(),
            options: *options,
            places: nodes
                .iter()
                .enumerate()
                .map(|(at, node)| (slot(node.id, node.kind), at))
                .collect(),
            nodes,
            vertices: vec![None; count],
            fixed: vec![false; count],
            links: Vec::new(),
            edges: Vec::new(),
            steps: Vec::new(),
            next: 0,
            handles: vec![None; count],
            starts: vec![None; count],
            order: Vec::with_capacity(count),
            priors: Vec::new(),
            factors: Vec::new(),
        };
        replay.gather(document)?;
        let by = if document.dialect() == Dialect::G2o { By::Id } else { By::Line };
        replay.steps = order::plan(&replay.nodes, &replay.links, &replay.fixed, by);
        Ok(replay)
    }

    /// Takes the numbers out of the records.
    fn gather(&mut self, document: &Document) -> Result<(), FormatError> {
        let mut sensors = HashMap::new();
        for record in document.records() {
            if let Record::SensorOffset { id, at } = record {
                sensors.extend(convert::pose3(at).map(|pose| (*id, pose)));
            }
        }
        let missing = |place: &Place, id| FormatError::MissingVertex { place: place.clone(), id };
        for Line { number: line, record, .. } in document.lines() {
            let place = document.place(*line);
            match record {
                Record::SensorOffset { .. } | Record::GeodeticOrigin { .. } => {}
                Record::Measurement(_) | Record::Linear(_) => {}
                Record::Vertex { id, at } => {
                    let node = self
                        .places
                        .get(&slot(*id, at.kind()))
                        .ok_or_else(|| missing(&place, *id))?;
                    self.vertices[*node] = Geometry::of(at);
                }
                Record::Fix { id } => {
                    let node = self.places.get(&(*id, true)).ok_or_else(|| missing(&place, *id))?;
                    self.fixed[*node] = true;
                }
                Record::Edge { from, to, measurement, weight, parameter } => {
                    let kind = measurement.kind();
                    let ends = [(*from, kind.observer()), (*to, kind)].map(|(id, kind)| {
                        self.places.get(&slot(id, kind)).copied().ok_or_else(|| missing(&place, id))
                    });
                    let [from, to] = ends;
                    self.links.push(Link { from: from?, to: to? });
                    self.edges.push(Measured {
                        line: *line,
                        measurement: Geometry::of(measurement)
                            .ok_or_else(|| bad(&place, "its quaternion names no rotation"))?,
                        sensor: parameter.and_then(|id| sensors.get(&id).copied()),
                        noise: measure::noise(document, weight, kind.dim(), &place)?,
                    });
                }
            }
        }
        Ok(())
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
        let result = self.emit(&step, change, Some(estimate));
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
            let step = self.emit(&step, change, None);
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
        let line = link.and_then(|link| self.edges.get(link)).map_or(0, |edge| edge.line);
        Place { file: Arc::clone(&self.name), line }
    }

    /// How many steps there are, taken ones included: one for each pose, but that poses which only
    /// landmarks tie to the rest come together.
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

    /// Landmarks with a vertex that no pose sees; they are left out.
    pub fn unseen_landmarks(&self) -> usize {
        let mut seen = vec![false; self.nodes.len()];
        self.links.iter().for_each(|link| seen[link.to] = true);
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
