//! Records as the tests want them.

use evergraph_formats::{Coordinates, Document, Record, Weight};
use evergraph_model::{Point3, Pose2, Pose3, Rot3};
use evergraph_simulate::World;

/// A [`Record::Edge`].
#[derive(Clone, Debug, PartialEq)]
pub struct Edge {
    pub from: u64,
    pub to: u64,
    pub measurement: Coordinates,
    pub weight: Weight,
}

/// All records, in order.
pub fn records(document: &Document) -> Vec<Record> {
    document.records().cloned().collect()
}

/// All edges, in order.
pub fn edges(world: &World) -> Vec<Edge> {
    let edge = |record: &Record| match record {
        Record::Edge { from, to, measurement, weight, .. } => {
            let weight = weight.clone();
            Some(Edge { from: *from, to: *to, measurement: *measurement, weight })
        }
        _ => None,
    };
    world.document.records().filter_map(edge).collect()
}

/// All vertices, in order.
pub fn vertices(document: &Document) -> Vec<(u64, Coordinates)> {
    let vertex = |record: &Record| match record {
        Record::Vertex { id, at } => Some((*id, *at)),
        _ => None,
    };
    document.records().filter_map(vertex).collect()
}

/// All 2D poses, in order.
pub fn poses2(document: &Document) -> Vec<Pose2> {
    let pose = |(_, at)| match at {
        Coordinates::Pose2([x, y, theta]) => Some(Pose2::new(x, y, theta)),
        _ => None,
    };
    vertices(document).into_iter().filter_map(pose).collect()
}

/// All 3D poses, in order.
pub fn poses3(document: &Document) -> Vec<Pose3> {
    vertices(document).iter().map(|(_, at)| pose3(at)).collect()
}

/// A pose that a file gives by quaternion.
pub fn pose3(at: &Coordinates) -> Pose3 {
    let Coordinates::Pose3Quaternion([x, y, z, qx, qy, qz, qw]) = *at else {
        panic!("not a 3D pose: {at:?}")
    };
    assert!(qw >= 0.0);
    let rotation = Rot3::from_quaternion(qx, qy, qz, qw).expect("a unit quaternion");
    Pose3::new(rotation, Point3::new(x, y, z))
}

/// 64-bit FNV-1a over ids, numbers bit by bit, and weights.
pub struct Fingerprint(u64);

impl Fingerprint {
    /// Of document and truth.
    pub fn of(world: &World) -> u64 {
        let mut hash = Self(0xcbf2_9ce4_8422_2325);
        for document in [&world.document, &world.truth] {
            for (id, at) in vertices(document) {
                hash.number(id);
                hash.coordinates(&at);
            }
        }
        for edge in edges(world) {
            hash.number(edge.from);
            hash.number(edge.to);
            hash.coordinates(&edge.measurement);
            edge.weight.entries.iter().for_each(|entry| hash.number(entry.to_bits()));
        }
        hash.0
    }

    fn coordinates(&mut self, at: &Coordinates) {
        at.numbers().iter().for_each(|number| self.number(number.to_bits()));
    }

    fn number(&mut self, number: u64) {
        for byte in number.to_le_bytes() {
            self.0 = (self.0 ^ u64::from(byte)).wrapping_mul(0x0000_0100_0000_01b3);
        }
    }
}
