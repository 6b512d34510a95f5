//! In which order the variables and edges of a file arrive. No numbers, only who touches whom.

use std::collections::VecDeque;

use crate::record::Kind;

/// A variable of the file.
#[derive(Clone, Copy, Debug)]
pub(super) struct Node {
    pub id: u64,
    pub kind: Kind,
}

/// An edge between [`Node`]s; a landmark is always `to`.
#[derive(Clone, Copy, Debug)]
pub(super) struct Link {
    pub from: usize,
    pub to: usize,
}

/// A variable that comes in, and the link that its start value is composed along; none for the
/// first pose of a part that nothing ties to a pose before it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Arrival {
    pub node: usize,
    pub along: Option<usize>,
}

/// What comes in together.
#[derive(Clone, Debug, Default)]
pub(super) struct Planned {
    /// In an order in which each start value can be composed.
    pub arrivals: Vec<Arrival>,
    /// Links, in the order met.
    pub links: Vec<usize>,
    /// Poses that get a gauge prior.
    pub gauge: Vec<usize>,
    /// Whether a link closes a cycle, other than by repeating the one that the pose came in by.
    pub closes: bool,
}

/// What the order goes by.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum By {
    /// Pose k arrives with every edge whose larger pose is k.
    Id,
    /// The order of the lines.
    Line,
}

/// Plans the whole file. `nodes` are sorted by id; `fixed` says which poses FIX lines name.
pub(super) fn plan(nodes: &[Node], links: &[Link], fixed: &[bool], by: By) -> Vec<Planned> {
    let mut planner = Planner::new(nodes, links, fixed, by);
    match by {
        By::Id => planner.feed_by_id(),
        By::Line => (0..links.len()).for_each(|link| planner.feed_line(link)),
    }
    planner.finish();
    planner.steps
}

struct Planner<'a> {
    nodes: &'a [Node],
    links: &'a [Link],
    fixed: &'a [bool],
    by: By,
    /// Connected component of each node, landmarks included; and by component, whether a pose of it
    /// is fixed and whether one is present.
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
    steps: Vec<Planned>,
}

impl<'a> Planner<'a> {
    fn new(nodes: &'a [Node], links: &'a [Link], fixed: &'a [bool], by: By) -> Self {
        let component = components(nodes.len(), links);
        let mut has_fixed = vec![false; nodes.len()];
        (0..nodes.len()).filter(|&n| fixed[n]).for_each(|n| has_fixed[component[n]] = true);
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
            steps: Vec::new(),
        }
    }

    fn feed_by_id(&mut self) {
        let mut of_pose = vec![Vec::new(); self.nodes.len()];
        for (index, link) in self.links.iter().enumerate() {
            let last = if self.is_pose(link.to) { link.from.max(link.to) } else { link.from };
            of_pose[last].push(index);
        }
        for (pose, mut batch) in of_pose.into_iter().enumerate() {
            if !self.is_pose(pose) {
                continue;
            }
            batch.iter().for_each(|&link| self.hold(link));
            let connects = batch.drain(..).any(|link| {
                let other = self.other(link, pose);
                self.is_pose(other) && self.is_present(other)
            });
            if connects || self.may_start(pose) {
                self.introduce(pose);
            }
        }
    }

    fn feed_line(&mut self, link: usize) {
        let Link { from, to } = self.links[link];
        if self.is_present(from) && (self.is_present(to) || !self.is_pose(to)) {
            self.place(link);
            return;
        }
        self.hold(link);
        let ends = if self.is_pose(to) { [from.min(to), from.max(to)] } else { [from, from] };
        let newcomer = match ends.map(|n| self.is_present(n)) {
            [true, _] => Some(ends[1]),
            [_, true] => Some(ends[0]),
            _ => ends.into_iter().find(|&n| self.may_start(n)),
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
                let mut whole = Planned { closes: true, ..Planned::default() };
                for part in parts {
                    whole.arrivals.extend(part.arrivals);
                    whole.links.extend(part.links);
                    whole.gauge.extend(part.gauge);
                }
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
            if self.fixed[pose] || !self.started[component] {
                step.gauge.push(pose);
            }
            self.started[component] = true;
            self.arrived[pose] = Some(self.steps.len());
            self.steps.push(step);
            for link in links {
                let other = self.other(link, pose);
                if self.is_pose(other) && !self.is_present(other) {
                    queue.push_back(other);
                } else {
                    self.place(link);
                }
            }
        }
    }

    /// Puts a link into the newest step, with its landmark if that is new.
    fn place(&mut self, link: usize) {
        let to = self.links[link].to;
        let newest = self.steps.len().saturating_sub(1);
        let Some(step) = self.steps.last_mut() else { return };
        if self.arrived[to].is_none() {
            self.arrived[to] = Some(newest);
            self.brought[to] = Some(link);
            step.arrivals.push(Arrival { node: to, along: Some(link) });
        }
        step.links.push(link);
    }

    /// Once a step's links are all known: which of them its pose starts from, and whether another
    /// closes a cycle.
    fn settle(&mut self, step: usize) {
        let Some(&Arrival { node: pose, .. }) = self.steps[step].arrivals.first() else { return };
        let ends = |link: usize| {
            let Link { from, to } = self.links[link];
            (from.min(to), from.max(to))
        };
        let touches = |link: &usize| {
            let Link { from, to } = self.links[*link];
            self.is_pose(to) && (from == pose || to == pose)
        };
        let links = &self.steps[step].links;
        let along = links
            .iter()
            .copied()
            .filter(touches)
            .min_by_key(|&link| self.preference(pose, self.other(link, pose)));
        let closes = links.iter().any(|&link| {
            let repeats = along.is_some_and(|along| ends(along) == ends(link));
            !repeats && self.brought[self.links[link].to] != Some(link)
        });
        self.steps[step].arrivals[0].along = along;
        self.steps[step].closes = closes;
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
        let Link { from, to } = self.links[link];
        for end in [from, to] {
            if self.is_pose(end) && !self.is_present(end) {
                self.held[end].push(link);
            }
        }
    }

    fn other(&self, link: usize, node: usize) -> usize {
        let Link { from, to } = self.links[link];
        if from == node { to } else { from }
    }

    fn is_pose(&self, node: usize) -> bool {
        self.nodes[node].kind.is_pose()
    }

    fn is_present(&self, node: usize) -> bool {
        self.arrived[node].is_some()
    }
}

/// The connected component of each node, named by one of its members.
pub(super) fn components(nodes: usize, links: &[Link]) -> Vec<usize> {
    fn root(parent: &mut [usize], mut node: usize) -> usize {
        while parent[node] != node {
            parent[node] = parent[parent[node]];
            node = parent[node];
        }
        node
    }
    let mut parent: Vec<usize> = (0..nodes).collect();
    for link in links {
        let (a, b) = (root(&mut parent, link.from), root(&mut parent, link.to));
        parent[a.max(b)] = a.min(b);
    }
    (0..nodes).map(|node| root(&mut parent, node)).collect()
}
