//! In which order the variables and edges of a file arrive. No numbers, only who touches whom.

use std::collections::VecDeque;

use evergraph_formats::Kind;
use smallvec::SmallVec;

use crate::components::Components;
use crate::options::Order;

/// A variable of the file.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Node {
    pub id: u64,
    pub kind: Kind,
}

/// A factor between [`Node`]s.
#[derive(Clone, Debug)]
pub(crate) struct Link {
    pub ends: SmallVec<[usize; 2]>,
    pub ties: Ties,
    /// When it was measured, seconds.
    pub time: Option<f64>,
}

/// What a link does for the order.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Ties {
    /// Poses of one kind: with all but one of them, it says where the last is.
    Poses,
    /// A pose and, last, a landmark: with the pose, it says where the landmark is.
    Sighting,
    /// Any variables: it brings none in, and waits for all.
    Weak,
}

/// A variable that comes in, and the link that its start value is composed along, with the other
/// end; none for the first pose of a part that nothing ties to a pose before it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Arrival {
    pub node: usize,
    pub along: Option<(usize, usize)>,
}

/// What comes in together.
#[derive(Clone, Debug, Default)]
pub(crate) struct Planned {
    /// In an order in which each start value can be composed.
    pub arrivals: Vec<Arrival>,
    /// Links, in the order met.
    pub links: Vec<usize>,
    /// Links that wait for landmarks which no sighting brings in.
    pub waiting: Vec<usize>,
    /// Poses that get a gauge prior, and how many of their directions are free.
    pub gauge: Vec<(usize, usize)>,
    /// Whether a link closes a cycle, other than by repeating the one that the pose came in by.
    pub closes: bool,
    /// Whether it is a part that poses before it are not tied to.
    pub is_part: bool,
}

impl Planned {
    /// Makes one step of two in a row.
    pub fn append(&mut self, next: Self) {
        self.arrivals.extend(next.arrivals);
        self.links.extend(next.links);
        self.waiting.extend(next.waiting);
        self.gauge.extend(next.gauge);
        self.closes |= next.closes;
        self.is_part |= next.is_part;
    }
}

/// What the order goes by.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum By {
    /// Pose k arrives with every edge whose larger pose is k.
    Id,
    /// The order of the lines, or of the times where they have any.
    Line,
}

impl From<Order> for By {
    fn from(order: Order) -> Self {
        match order {
            Order::Ids | Order::IdsForLateEdges => Self::Id,
            Order::Lines | Order::Times => Self::Line,
        }
    }
}

/// The links in the order of a file that is in time order, or has times: odometry comes before what
/// is measured at the pose that it brings in.
fn in_time_order(links: &[Link]) -> Vec<usize> {
    let mut order: Vec<usize> = (0..links.len()).collect();
    if links.iter().any(|link| link.time.is_some()) {
        order.sort_by(|&a, &b| {
            let key = |link: &Link| link.time.unwrap_or(f64::NEG_INFINITY);
            let (a, b) = (&links[a], &links[b]);
            key(a).total_cmp(&key(b)).then((a.ties != Ties::Poses).cmp(&(b.ties != Ties::Poses)))
        });
    }
    order
}

/// Plans the whole file. `nodes` are sorted by id; `fixed` says which of them FIX lines name.
pub(crate) fn plan(nodes: &[Node], links: &[Link], fixed: &[bool], by: By) -> Vec<Planned> {
    let mut planner = Planner::new(nodes, links, fixed, by);
    match by {
        By::Id => planner.feed_by_id(),
        By::Line => in_time_order(links).into_iter().for_each(|link| planner.feed_line(link)),
    }
    planner.finish();
    planner.place_weak();
    planner.steps
}

struct Planner<'a> {
    nodes: &'a [Node],
    links: &'a [Link],
    fixed: &'a [bool],
    by: By,
    /// Connected component of each node, landmarks included; and by component, whether a pose of it
    /// is fixed, and whether one is present.
    component: Vec<usize>,
    has_fixed: Vec<bool>,
    started: Vec<bool>,
    /// Step in which each node came in.
    arrived: Vec<Option<usize>>,
    /// The link that each landmark came in by.
    brought: Vec<Option<usize>>,
    /// Links of each pose that was met before both ends were present, in the order met.
    held: Vec<Vec<usize>>,
    /// The pose before each pose, by id.
    before: Vec<Option<usize>>,
    /// The step in which each weak link was met.
    met: Vec<usize>,
    steps: Vec<Planned>,
}

impl<'a> Planner<'a> {
    fn new(nodes: &'a [Node], links: &'a [Link], fixed: &'a [bool], by: By) -> Self {
        let component = components(nodes.len(), links);
        let mut has_fixed = vec![false; nodes.len()];
        let fixed_poses = (0..nodes.len()).filter(|&n| fixed[n] && nodes[n].kind.is_pose());
        fixed_poses.for_each(|n| has_fixed[component[n]] = true);
        let mut before = vec![None; nodes.len()];
        let mut last = None;
        for (n, _) in nodes.iter().enumerate().filter(|(_, node)| node.kind.is_pose()) {
            before[n] = last;
            last = Some(n);
        }
        Self {
            nodes,
            links,
            fixed,
            by,
            component,
            has_fixed,
            started: vec![false; nodes.len()],
            arrived: vec![None; nodes.len()],
            brought: vec![None; nodes.len()],
            held: vec![Vec::new(); nodes.len()],
            before,
            met: vec![0; links.len()],
            steps: Vec::new(),
        }
    }

    fn feed_by_id(&mut self) {
        let mut of_pose = vec![Vec::new(); self.nodes.len()];
        for (index, link) in self.links.iter().enumerate() {
            let last = match link.ties {
                Ties::Poses => link.ends.iter().copied().max(),
                Ties::Sighting => link.ends.first().copied(),
                Ties::Weak => None,
            };
            if let Some(last) = last {
                of_pose[last].push(index);
            }
        }
        for (pose, mut batch) in of_pose.into_iter().enumerate() {
            if !self.is_pose(pose) {
                continue;
            }
            batch.iter().for_each(|&link| self.hold(link));
            let connects = batch.drain(..).any(|link| self.others_are_present(link, pose));
            if connects || self.may_start(pose) {
                self.introduce(pose);
            }
        }
    }

    fn feed_line(&mut self, link: usize) {
        if self.links[link].ties == Ties::Weak {
            self.met[link] = self.steps.len().saturating_sub(1);
            return;
        }
        let mut absent: SmallVec<[usize; 2]> = self.absent_poses(link).collect();
        if absent.is_empty() {
            self.place(link);
            return;
        }
        self.hold(link);
        absent.sort_unstable();
        let newcomer = match absent[..] {
            [last] if self.poses(link) > 1 => Some(last),
            _ => absent.into_iter().find(|&n| self.may_start(n)),
        };
        if let Some(pose) = newcomer {
            self.introduce(pose);
        }
    }

    /// What nothing ties to a pose that is present: poses without edges, then parts that only
    /// landmarks tie to the rest, a step for each part.
    fn finish(&mut self) {
        for pose in 0..self.nodes.len() {
            if self.is_pose(pose) && !self.is_present(pose) && self.may_start(pose) {
                self.introduce(pose);
            }
        }
        (0..self.steps.len()).for_each(|step| self.settle(step));
        for pose in 0..self.nodes.len() {
            if self.is_pose(pose) && !self.is_present(pose) {
                let first = self.steps.len();
                self.introduce(pose);
                (first..self.steps.len()).for_each(|step| self.settle(step));
                let parts = self.steps.split_off(first);
                let mut whole = Planned { closes: true, is_part: true, ..Planned::default() };
                parts.into_iter().for_each(|part| whole.append(part));
                for arrival in &whole.arrivals {
                    self.arrived[arrival.node] = Some(first);
                }
                self.steps.push(whole);
            }
        }
    }

    /// Whether the pose may be the first of its component: nothing is there yet, and it is fixed if
    /// any of them is.
    fn may_start(&self, pose: usize) -> bool {
        let component = self.component[pose];
        !self.started[component] && (self.fixed[pose] || !self.has_fixed[component])
    }

    /// Brings a pose in, then all that was held back for want of it.
    fn introduce(&mut self, pose: usize) {
        let mut queue = VecDeque::from([pose]);
        while let Some(pose) = queue.pop_front() {
            if self.is_present(pose) {
                continue;
            }
            let links = std::mem::take(&mut self.held[pose]);
            let component = self.component[pose];
            let mut step = Planned::default();
            step.arrivals.push(Arrival { node: pose, along: None });
            if !self.started[component] && !self.has_fixed[component] {
                step.gauge.push((pose, self.nodes[pose].kind.dim()));
            }
            self.started[component] = true;
            self.arrived[pose] = Some(self.steps.len());
            self.steps.push(step);
            for link in links {
                let absent: SmallVec<[usize; 2]> = self.absent_poses(link).collect();
                match absent[..] {
                    [] => self.place(link),
                    [last] => queue.push_back(last),
                    // It is held at each of them.
                    _ => {}
                }
            }
        }
    }

    /// Puts a link into the newest step, with its landmark if that is new.
    fn place(&mut self, link: usize) {
        let newest = self.steps.len().saturating_sub(1);
        let Some(step) = self.steps.last_mut() else { return };
        if let (Ties::Sighting, &[from, to]) = (self.links[link].ties, &self.links[link].ends[..])
            && self.arrived[to].is_none()
        {
            self.arrived[to] = Some(newest);
            self.brought[to] = Some(link);
            step.arrivals.push(Arrival { node: to, along: Some((link, from)) });
        }
        step.links.push(link);
    }

    /// Once a step's links are all known: which of them its pose starts from, and whether another
    /// closes a cycle.
    fn settle(&mut self, step: usize) {
        let Some(&Arrival { node: pose, .. }) = self.steps[step].arrivals.first() else { return };
        let links = &self.steps[step].links;
        let along = links
            .iter()
            .copied()
            .filter(|&link| self.links[link].ties == Ties::Poses)
            .filter(|&link| self.links[link].ends.contains(&pose))
            .flat_map(|link| self.links[link].ends.iter().map(move |&other| (link, other)))
            .filter(|&(_, other)| other != pose)
            .min_by_key(|&(_, other)| self.preference(pose, other));
        let closes = links.iter().any(|&link| {
            let brings = self.links[link].ends.last().is_some_and(|&to| {
                self.links[link].ties == Ties::Sighting && self.brought[to] == Some(link)
            });
            !brings && !along.is_some_and(|(along, _)| self.repeats(link, along))
        });
        self.steps[step].arrivals[0].along = along;
        self.steps[step].closes = closes;
    }

    /// Puts each weak link into the step that brings the last of its ends in, but not before the one
    /// in which it was met.
    fn place_weak(&mut self) {
        for (index, link) in self.links.iter().enumerate() {
            if link.ties != Ties::Weak {
                continue;
            }
            let ends = || link.ends.iter().map(|&end| self.arrived[end]);
            let at = ends().flatten().max().unwrap_or(0).max(self.met[index]);
            let all_come = ends().all(|step| step.is_some());
            let Some(&Arrival { along, .. }) =
                self.steps.get(at).and_then(|step| step.arrivals.first())
            else {
                continue;
            };
            let repeats = along.is_some_and(|(along, _)| self.repeats(index, along));
            let step = &mut self.steps[at];
            if all_come {
                step.links.push(index);
                step.closes |= link.ends.len() > 1 && !repeats;
            } else {
                step.waiting.push(index);
            }
        }
    }

    /// Whether a link has the same ends as another.
    fn repeats(&self, link: usize, other: usize) -> bool {
        let (a, b) = (&self.links[link].ends, &self.links[other].ends);
        a.len() == b.len() && a.iter().all(|end| b.contains(end))
    }

    /// Smaller is better: by id the pose just before, then the latest before, then the next after;
    /// by line the pose that came in last.
    fn preference(&self, pose: usize, other: usize) -> (u8, usize) {
        match self.by {
            By::Line => (0, usize::MAX - self.arrived[other].unwrap_or(0)),
            By::Id if self.before[pose] == Some(other) => (0, 0),
            By::Id if other < pose => (1, usize::MAX - other),
            By::Id => (2, other),
        }
    }

    fn hold(&mut self, link: usize) {
        let absent: SmallVec<[usize; 2]> = self.absent_poses(link).collect();
        absent.into_iter().for_each(|pose| self.held[pose].push(link));
    }

    fn absent_poses(&self, link: usize) -> impl Iterator<Item = usize> {
        let ends = self.links[link].ends.iter().copied();
        ends.filter(|&end| self.is_pose(end) && !self.is_present(end))
    }

    /// Whether a link is between poses, and all but `pose` are present.
    fn others_are_present(&self, link: usize, pose: usize) -> bool {
        self.poses(link) > 1 && self.absent_poses(link).all(|absent| absent == pose)
    }

    fn poses(&self, link: usize) -> usize {
        self.links[link].ends.iter().filter(|&&end| self.is_pose(end)).count()
    }

    fn is_pose(&self, node: usize) -> bool {
        self.nodes[node].kind.is_pose()
    }

    fn is_present(&self, node: usize) -> bool {
        self.arrived[node].is_some()
    }
}

/// The connected component of each node, named by its lowest node.
pub(crate) fn components(nodes: usize, links: &[Link]) -> Vec<usize> {
    let mut components = Components::new(nodes);
    links.iter().for_each(|link| components.join(&link.ends));
    components.of_all()
}
