//! A file as the changes that a robot would have made.

use std::collections::BTreeMap;
use std::sync::Arc;

use evergraph_formats::{Dialect, Document};
use evergraph_model::{Change, Graph, Noise, Value, VariableId};

use crate::error::ReplayerError;
use crate::geometry::{Handle, origin, slot};
use crate::options::{Order, ReplayOptions, Step};
use crate::order::{self, Node};
use crate::recorded;
use crate::state::Replay;

impl Replay {
    /// Plans the replay of a document.
    ///
    /// # Errors
    /// [`ReplayerError::NoPose`], [`ReplayerError::BadSetting`], [`ReplayerError::Format`] for a
    /// matrix that overflows.
    pub fn new(document: &Document, options: &ReplayOptions) -> Result<Self, ReplayerError> {
        if let Some(sigma) = options.prior
            && Noise::isotropic(1, sigma).is_err()
        {
            let (setting, demand) = ("sigma of the gauge prior", "positive and finite");
            return Err(ReplayerError::BadSetting { setting, value: sigma, demand });
        }
        let nodes: Vec<Node> =
            document.ids().into_iter().map(|(id, kind)| Node { id, kind }).collect();
        if !nodes.iter().any(|node| node.kind.is_pose()) {
            return Err(ReplayerError::NoPose { file: document.name().into() });
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
                .map(|node| Handle::add(&origin(node.kind), &mut scratch))
                .collect(),
            nodes,
            vertices: vec![None; count],
            fixed: vec![false; count],
            links: Vec::new(),
            observations: Vec::new(),
            recorded: Order::Lines,
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
        let has_order = document.dialect() != Dialect::G2o;
        replay.recorded = recorded::order_of(&replay.links, &replay.nodes, has_order);
        replay.component = order::components(count, &replay.links);
        replay.steps =
            order::plan(&replay.nodes, &replay.links, &replay.fixed, replay.recorded.into());
        replay.settle_gauge()?;
        Ok(replay)
    }

    /// Fills an empty `change`, made from the graph as it is now, with the next step; `None` when
    /// there is none. `estimate` gives the current estimate of a variable of an earlier step. Apply
    /// the change before asking for the next.
    ///
    /// # Errors
    /// [`ReplayerError::NoEstimate`], [`ReplayerError::StartNotFinite`],
    /// [`ReplayerError::Format`]. After an error there are no more steps.
    pub fn next_step(
        &mut self,
        change: &mut Change,
        estimate: &mut dyn FnMut(VariableId) -> Option<Value>,
    ) -> Option<Result<Step, ReplayerError>> {
        let step = self.steps.get_mut(self.next).map(std::mem::take)?;
        self.next += 1;
        let result = self.emit(step, change, Some(estimate));
        if result.is_err() {
            self.next = self.steps.len();
        }
        Some(result)
    }

    /// Fills an empty `change` with all steps that are left: for a fresh replay the whole file, as
    /// one step. Start values are the file's vertices or composed, as [`Initial`](crate::Initial) says, in the
    /// order of the steps.
    ///
    /// # Errors
    /// As [`next_step`](Self::next_step); [`ReplayerError::NoPose`] when no step is left.
    pub fn everything(&mut self, change: &mut Change) -> Result<Step, ReplayerError> {
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
        whole.ok_or_else(|| ReplayerError::NoPose { file: Arc::clone(&self.name) })
    }
}
