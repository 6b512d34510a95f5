//! What a file holds as a graph.

use std::collections::{BTreeMap, HashMap};

use evergraph_formats::{Document, Record};

use crate::components::Components;

/// What a file holds, as a graph.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Overview {
    /// Lines of each kind, in words.
    pub records: BTreeMap<String, usize>,
    /// Connected components, by their lowest id.
    pub components: Vec<Component>,
    /// Lowest and highest id of a pose.
    pub pose_ids: Option<(u64, u64)>,
    /// Lowest and highest id of a landmark.
    pub landmark_ids: Option<(u64, u64)>,
    /// Pairs of variables that more than one edge joins, in whichever direction.
    pub repeated_pairs: usize,
    /// Edges beyond the first of their pair.
    pub repeated_edges: usize,
    /// The component of each variable, by id and whether it is a pose.
    members: HashMap<(u64, bool), usize>,
}

/// A part of a graph that no factor ties to the rest.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct Component {
    /// Its lowest id, of a pose if it has one.
    pub first: u64,
    /// Poses in it.
    pub poses: usize,
    /// Landmarks in it.
    pub landmarks: usize,
}

impl Overview {
    /// Looks a document over.
    pub fn of(document: &Document) -> Self {
        let ids = document.ids();
        let places: HashMap<(u64, bool), usize> =
            ids.iter().enumerate().map(|(at, (id, kind))| ((*id, kind.is_pose()), at)).collect();
        let mut overview = Self::default();
        let mut components = Components::new(ids.len());
        let mut pairs: HashMap<(usize, usize), usize> = HashMap::new();
        for record in document.records() {
            *overview.records.entry(Self::kind_of(record)).or_default() += 1;
            let ends: Vec<usize> = record
                .ends()
                .iter()
                .filter_map(|(id, kind)| places.get(&(*id, kind.is_pose())).copied())
                .collect();
            if let (Record::Edge { .. }, &[a, b]) = (record, &ends[..]) {
                *pairs.entry((a.min(b), a.max(b))).or_default() += 1;
            }
            components.join(&ends);
        }
        overview.repeated_pairs = pairs.values().filter(|&&edges| edges > 1).count();
        overview.repeated_edges = pairs.values().map(|edges| edges - 1).sum();

        let mut of_root: HashMap<usize, usize> = HashMap::new();
        for (at, (id, kind)) in ids.iter().enumerate() {
            let index = *of_root.entry(components.of(at)).or_insert_with(|| {
                overview.components.push(Component { first: *id, poses: 0, landmarks: 0 });
                overview.components.len() - 1
            });
            overview.members.insert((*id, kind.is_pose()), index);
            let component = &mut overview.components[index];
            let (count, range) = if kind.is_pose() {
                (&mut component.poses, &mut overview.pose_ids)
            } else {
                (&mut component.landmarks, &mut overview.landmark_ids)
            };
            *count += 1;
            let (low, high) = range.unwrap_or((*id, *id));
            *range = Some((low.min(*id), high.max(*id)));
        }
        overview
    }

    /// Which of [`components`](Self::components) a variable is part of; a pose and a landmark may have
    /// the same id.
    pub fn component_of(&self, id: u64, is_pose: bool) -> Option<usize> {
        self.members.get(&(id, is_pose)).copied()
    }

    /// The component that a pose is part of.
    pub fn component_of_pose(&self, id: u64) -> Option<&Component> {
        self.components.get(self.component_of(id, true)?)
    }

    /// Kind of a line in words, as in [`records`](Self::records).
    pub fn kind_of(record: &Record) -> String {
        match record {
            Record::Vertex { at, .. } => format!("{} vertices", at.kind().name()),
            Record::Edge { measurement, .. } if measurement.kind().is_pose() => {
                format!("edges to a {}", measurement.kind().name())
            }
            Record::Edge { measurement, .. } => {
                format!("sightings of a {}", measurement.kind().name())
            }
            Record::Fix { .. } => "fixed vertices".into(),
            Record::SensorOffset { .. } => "sensor offsets".into(),
            Record::GeodeticOrigin { .. } => "geodetic origins".into(),
            Record::Linear(_) => "linear factors".into(),
            Record::Measurement(measurement) => measurement.quantity.name().into(),
        }
    }
}

#[cfg(test)]
mod tests {
    use evergraph_formats::ReadOptions;

    use super::*;

    #[test]
    fn components_and_repeated_pairs_are_counted() {
        let i = "1 0 0 1 0 1";
        let text = format!(
            "EDGE_SE2 5 6 1 0 0 {i}\nEDGE_SE2 6 5 -1 0 0 {i}\nEDGE_SE2 8 9 1 0 0 {i}\n\
             EDGE_SE2_XY 9 20 1 1 1 0 1\n"
        );
        let document = Document::parse("test", text.as_bytes(), &ReadOptions::default()).unwrap();
        let overview = Overview::of(&document);
        let expected = [
            Component { first: 5, poses: 2, landmarks: 0 },
            Component { first: 8, poses: 2, landmarks: 1 },
        ];
        assert_eq!(overview.components, expected);
        let of = |id, is_pose| overview.component_of(id, is_pose);
        assert_eq!((of(6, true), of(20, false), of(20, true)), (Some(0), Some(1), None));
        assert_eq!((overview.repeated_pairs, overview.repeated_edges), (1, 1));
        assert_eq!((overview.pose_ids, overview.landmark_ids), (Some((5, 9)), Some((20, 20))));
        assert_eq!(overview.records["edges to a 2D pose"], 3);
    }

    #[test]
    fn any_factor_ties_variables() {
        let text = "VERTEX_SE2 0 0 0 0\nVERTEX_SE2 1 0 0 0\nVERTEX_SE2 2 0 0 0\nVERTEX_XY 3 0 0\n\
                    FACTOR_RANGE_SE2 0 1 2 1\nEDGE_PRIOR_XY 3 0 0 1 0 1\n";
        let document = Document::parse("test", text.as_bytes(), &ReadOptions::default()).unwrap();
        let overview = Overview::of(&document);
        assert_eq!(overview.components.len(), 3);
        assert_eq!((overview.records["ranges"], overview.records["priors"]), (1, 1));
        assert_eq!((overview.repeated_pairs, overview.repeated_edges), (0, 0));
    }
}
