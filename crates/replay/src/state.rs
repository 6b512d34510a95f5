//! A document being replayed: its parts, and what of them has come in.

use std::collections::{BTreeMap, HashMap};
use std::sync::Arc;

use evergraph_formats::Place;
use evergraph_model::{FactorId, VariableId};

use crate::geometry::{Geometry, Handle};
use crate::observation::Observation;
use crate::options::{GaugePrior, Order, ReplayOptions};
use crate::order::{Link, Node, Planned};

/// The steps of a document, one new pose each.
///
/// **Order.** In a g2o file, which has no time, pose k (by id) arrives with every edge whose larger
/// pose is k. TORO and iSAM files are in time order: a step is one new pose and every line up to the
/// next new pose. They are replayed by id, too, where most loop closures stand behind later poses
/// ([`order`](Self::order)). Where lines have times they are sorted by them, odometry first among equals. Edges
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
/// origin if it has none. Absolute measurements and fixed landmarks inform some directions; the prior
/// is for the others, and there is none if no direction is left ([`Gauge`](evergraph_initialize::Gauge)).
/// Steps of a component are joined until all directions that are known in the end are known: a robot
/// that only knows its positions has no heading before it moves.
/// A part that is tied to the rest by landmarks or ranges only, and that they leave free in some
/// directions, gets a weak prior (1 m, 1 rad) in those.
///
/// **FIX.** A fixed variable, pose or landmark, stays at its vertex ([`Change::fix`](evergraph_model::Change::fix)); without a vertex
/// it stays where it starts. A component with fixed poses begins with one of them and has no gauge prior.
///
/// ```
/// use evergraph_formats::{Document, ReadOptions};
/// use evergraph_model::{Graph, Value, VariableId};
/// use evergraph_replay::{Replay, ReplayOptions};
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
    pub(crate) name: Arc<str>,
    pub(crate) options: ReplayOptions,
    pub(crate) nodes: Vec<Node>,
    pub(crate) vertices: Vec<Option<Geometry>>,
    pub(crate) fixed: Vec<bool>,
    /// Where each variable stands among the nodes, by id and whether it is a pose.
    pub(crate) places: HashMap<(u64, bool), usize>,
    pub(crate) links: Vec<Link>,
    pub(crate) recorded: Order,
    /// What each link is.
    pub(crate) observations: Vec<Observation>,
    /// The connected component of each node, named by one of its members.
    pub(crate) component: Vec<usize>,
    /// Landmarks whose place a prior gives, and nothing else does; fixed variables at their vertices.
    pub(crate) anchors: Vec<Option<Geometry>>,
    /// Variables of no graph, to evaluate factors on.
    pub(crate) scratch: Vec<Handle>,
    pub(crate) steps: Vec<Planned>,
    pub(crate) next: usize,
    pub(crate) handles: Vec<Option<Handle>>,
    /// Where each variable stands in `order`, and its start value.
    pub(crate) starts: Vec<Option<(usize, Geometry)>>,
    /// Nodes that have come in, in order.
    pub(crate) order: Vec<usize>,
    pub(crate) held: BTreeMap<usize, Held>,
    pub(crate) priors: Vec<GaugePrior>,
    pub(crate) factors: Vec<(FactorId, usize)>,
}

/// A landmark that is not in yet.
#[derive(Clone, Debug)]
pub(crate) struct Held {
    /// Its links of which all other ends have come in.
    pub usable: Vec<usize>,
    /// Its links that wait for other landmarks, too, or were not looked at yet.
    pub pending: Vec<usize>,
    /// With how many usable links to try next.
    pub next_try: usize,
}

impl Replay {
    pub(crate) fn place(&self, link: Option<usize>) -> Place {
        let line = link.and_then(|link| self.observations.get(link)).map_or(0, |seen| seen.line);
        Place { file: Arc::clone(&self.name), line }
    }

    /// How many steps there are, taken ones included: one for each pose, but that poses which no
    /// edges between poses tie to the rest come together, and so do those until absolute measurements
    /// hold them. Fewer once parts had to be joined.
    pub fn len(&self) -> usize {
        self.steps.len()
    }

    /// The order of the steps.
    pub fn order(&self) -> Order {
        self.recorded
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

    /// The ids of the fixed variables that have been added, in the order of arrival, and the variables.
    pub fn fixed(&self) -> impl Iterator<Item = (u64, VariableId)> {
        let fixed = self.order.iter().filter(|&&node| self.fixed[node]);
        fixed.filter_map(|&node| Some((self.nodes[node].id, self.handles[node]?.id())))
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
