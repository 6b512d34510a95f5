//! Ids that the records of factors refer to.

use std::collections::HashMap;

use evergraph_model::{Pose3, Value, VariableId};

use super::settle;
use crate::coordinates::{Coordinates, Kind};
use crate::estimate::coordinates;
use crate::options::Dialect;

/// Ids that the records of factors refer to.
#[derive(Default)]
pub(super) struct Exporter {
    /// Id and kind of each variable.
    pub ends: HashMap<VariableId, (u64, Kind)>,
    /// Positions of sensors on the robot; their places here are their ids.
    pub sensors: Vec<Pose3>,
}

impl Exporter {
    pub fn id(&self, variable: VariableId) -> Option<u64> {
        self.ends.get(&variable).map(|(id, _)| *id)
    }

    pub fn end(&self, variable: VariableId) -> Option<(u64, Kind)> {
        self.ends.get(&variable).copied()
    }

    /// The id of a sensor offset.
    pub fn sensor(&mut self, robot_from_sensor: &Pose3) -> u64 {
        let known = self.sensors.iter().position(|sensor| sensor == robot_from_sensor);
        let at = known.unwrap_or_else(|| {
            self.sensors.push(*robot_from_sensor);
            self.sensors.len() - 1
        });
        at as u64
    }
}

/// The numbers of a value that is known to be one that files hold.
pub(super) fn settled(value: &Value) -> Option<Coordinates> {
    coordinates(value, Dialect::G2o).map(settle::coordinates)
}
