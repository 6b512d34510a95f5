//! Chordal initialization of a document.

use std::collections::HashSet;

use evergraph_formats::Document;
use evergraph_model::{Graph, Value, VariableId};
use evergraph_solver::{Settings, SmootherError};

use crate::error::ReplayerError;
use crate::options::{Initial, ReplayOptions};
use crate::state::Replay;

/// Start values of a document's poses and landmarks from its measurements alone, by ids in the file:
/// [`evergraph_initialize::chordal`].
///
/// Poses that FIX names keep their vertices. So does the first pose of each connected part without one;
/// where it has no vertex, it starts as a replay would start it.
///
/// # Errors
/// [`ReplayerError::Format`] when the document is no graph, [`ReplayerError::Smoother`] when the
/// settings cannot be, [`ReplayerError::Chordal`] when weights differ so much that the linear
/// systems cannot be solved.
///
/// ```
/// use evergraph_formats::{Document, ReadOptions};
/// use evergraph_model::Pose2;
/// use evergraph_solver::Settings;
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// let text = "EDGE_SE2 0 1 1 0 1.5 4 0 0 4 0 9\nEDGE_SE2 1 2 2 0 1.5 4 0 0 4 0 9\n";
/// let document = Document::parse("chain", text.as_bytes(), &ReadOptions::default())?;
/// let start = evergraph_replay::chordal(&document, &Settings::default())?;
/// let last: Pose2 = start[2].1.get().ok_or("a pose")?;
/// assert!((last.theta() - 3.0).abs() < 1e-9 && (last.y() - 2.0 * 1.5_f64.sin()).abs() < 1e-9);
/// # Ok(())
/// # }
/// ```
pub fn chordal(
    document: &Document,
    settings: &Settings,
) -> Result<Vec<(u64, Value)>, ReplayerError> {
    settings.check().map_err(SmootherError::from)?;
    let options = ReplayOptions { prior: None, initial: Initial::FromFile, kernel: None };
    let mut replay = Replay::new(document, &options)?;
    let mut change = Graph::new().change();
    replay.everything(&mut change)?;
    let fixed: HashSet<VariableId> = replay.fixed().map(|(_, variable)| variable).collect();
    let factors = change.new_factors().iter().map(|(_, factor)| &**factor);
    let found = evergraph_initialize::chordal(change.new_variables(), factors, &fixed, settings);
    let found = found.map_err(|source| ReplayerError::Chordal {
        file: document.name().into(),
        source: Box::new(source),
    })?;
    // Variables come in in the order of their ids' arrival.
    let starts = replay.ids().zip(change.new_variables()).zip(found);
    let start = |(((id, variable), (_, given)), (_, found)): ((_, &(_, Value)), _)| {
        (id, if fixed.contains(&variable) { given.clone() } else { found })
    };
    Ok(starts.map(start).collect())
}

#[cfg(test)]
mod tests {
    use evergraph_formats::{Coordinates, Line, ReadOptions, Record};
    use std::collections::HashMap;

    use evergraph_model::{Point2, Pose2, Pose3, Rot3};
    use evergraph_simulate::{Grid, Landmarks, Surface};
    use nalgebra::Vector3;

    use super::*;

    fn parse(text: &str) -> Document {
        Document::parse("test", text.as_bytes(), &ReadOptions::default()).unwrap()
    }

    fn start(document: &Document) -> HashMap<u64, Value> {
        chordal(document, &Settings::default()).unwrap().into_iter().collect()
    }

    /// The vertices of a document as values.
    fn vertices(document: &Document) -> HashMap<u64, Value> {
        let value = |at: &Coordinates| match *at {
            Coordinates::Pose2([x, y, theta]) => Value::new(&Pose2::new(x, y, theta)),
            Coordinates::Pose3Quaternion([x, y, z, qx, qy, qz, qw]) => {
                let rotation = Rot3::from_quaternion(qx, qy, qz, qw).unwrap();
                Value::new(&Pose3::new(rotation, Vector3::new(x, y, z)))
            }
            Coordinates::Point2([x, y]) => Value::new(&Point2::new(x, y)),
            _ => panic!("no world has {at:?}"),
        };
        let vertex = |record: &Record| match record {
            Record::Vertex { id, at } => Some((*id, value(at))),
            _ => None,
        };
        document.records().filter_map(vertex).collect()
    }

    /// The document with every vertex but the first far from where it belongs.
    fn scattered(document: &Document) -> Document {
        let scatter = |line: &Line| {
            let mut line = line.clone();
            if let Record::Vertex { id, at } = &mut line.record
                && *id > 0
            {
                *at = match *at {
                    Coordinates::Pose2([x, y, a]) => Coordinates::Pose2([7.0 - y, x, 2.0 - a]),
                    Coordinates::Pose3Quaternion([x, y, z, ..]) => {
                        Coordinates::Pose3Quaternion([y, 3.0 - z, x, 1.0, 0.0, 0.0, 0.0])
                    }
                    Coordinates::Point2([x, y]) => Coordinates::Point2([y, -x]),
                    other => other,
                };
            }
            line
        };
        let lines: Vec<Line> = document.lines().iter().map(scatter).collect();
        Document::from_records("scattered", document.dialect(), lines).unwrap()
    }

    fn distance(a: &Value, b: &Value) -> f64 {
        let mut local = vec![0.0; a.dim()];
        a.kind().local(a.storage(), b.storage(), &mut local);
        local.iter().fold(0.0, |most, x| most.max(x.abs()))
    }

    #[test]
    fn without_noise_the_truth_is_recovered() {
        let mut manhattan = Grid::manhattan(300, 1);
        let mut city = Grid::city(300, 2);
        for grid in [&mut manhattan, &mut city] {
            grid.odometry = [1e-9; 3];
            grid.closures.sigmas = [1e-9; 3];
        }
        city.landmarks = Some(Landmarks::default().with_density(0.05).with_sigmas([1e-9; 2]));
        let mut sphere = Surface::sphere(300, 3);
        let mut torus = Surface::torus(300, 4);
        for surface in [&mut sphere, &mut torus] {
            surface.odometry = [1e-9; 6];
            surface.closures.sigmas = [1e-9; 6];
        }
        for world in [manhattan.generate(), city.generate(), sphere.generate(), torus.generate()] {
            let world = world.unwrap();
            let truth = vertices(&world.truth);
            let document = scattered(&world.document);
            let (found, scattered) = (start(&document), vertices(&document));
            assert!(found.len() >= 300);
            for (id, value) in &found {
                assert!(distance(value, &truth[id]) < 1e-5, "{id}: {value:?}");
            }
            assert!(distance(&scattered[&7], &truth[&7]) > 0.1);
        }
    }

    const UNIT: &str = "1 0 0 1 0 1";

    #[test]
    fn what_is_fixed_stays_and_parts_begin_at_their_vertices() {
        let text = format!(
            "VERTEX_SE2 0 5 6 1\nVERTEX_SE2 1 9 9 0\nVERTEX_SE2 2 7 7 0.5\nVERTEX_SE2 8 1 2 3\n\
             VERTEX_SE2 9 0 0 0\nEDGE_SE2 0 1 1 0 0 {UNIT}\nEDGE_SE2 1 2 1 0 0 {UNIT}\n\
             EDGE_SE2 8 9 1 0 0 {UNIT}\nFIX 2\n"
        );
        let document = parse(&text);
        let (found, given) = (start(&document), vertices(&document));
        assert_eq!((&found[&2], &found[&8]), (&given[&2], &given[&8]));
        let first: Pose2 = found[&0].get().unwrap();
        let (sin, cos) = 0.5_f64.sin_cos();
        let expected = Value::new(&Pose2::new(7.0 - 2.0 * cos, 7.0 - 2.0 * sin, 0.5));
        assert!(distance(&Value::new(&first), &expected) < 1e-9, "{first:?}");
    }

    #[test]
    fn parts_of_an_edge_without_weight_do_not_count() {
        // The second edge says nothing of the rotation: pose 2 keeps that of its vertex.
        let text = format!(
            "VERTEX_SE2 0 0 0 0\nVERTEX_SE2 1 0 0 0\nVERTEX_SE2 2 0 0 0.25\n\
             EDGE_SE2 0 1 1 0 1 {UNIT}\nEDGE_SE2 1 2 1 0 1 1 0 0 1 0 0\n"
        );
        let last: Pose2 = start(&parse(&text))[&2].get().unwrap();
        assert!((last.theta() - 0.25).abs() < 1e-12);
        assert!((last.y() - 1.0_f64.sin()).abs() < 1e-12, "{last:?}");
    }

    #[test]
    fn a_part_with_a_fixed_pose_follows_it_wherever_it_comes() {
        // As to rotations, poses 1 and 2 are a part of their own, and 2 is fixed.
        let text = format!(
            "VERTEX_SE2 0 0 0 0\nVERTEX_SE2 1 1 0 2\nVERTEX_SE2 2 2 0 0.5\n\
             EDGE_SE2 0 1 1 0 1 1 0 0 1 0 0\nEDGE_SE2 1 2 1 0 0.25 {UNIT}\nFIX 0\nFIX 2\n"
        );
        let found = start(&parse(&text));
        let theta = |id: u64| found[&id].get::<Pose2>().unwrap().theta();
        assert!((theta(1) - 0.25).abs() < 1e-12 && theta(2) == 0.5, "{found:?}");
    }
}
