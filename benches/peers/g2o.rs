//! Reads the pose graphs of g2o files, for the peers that are written in Rust.
//!
//! Quaternions are normalized and matrices are taken as they stand (translation before rotation,
//! rotation in angle units), as Evergraph and the GTSAM scripts do, so that every peer minimizes
//! `1/2 sum r^T I r` with the same `I`.

use nalgebra::{DMatrix, DVector};

/// `x y theta`, or `x y z qx qy qz qw` with a unit quaternion.
pub type Pose = DVector<f64>;

pub struct Edge {
    pub from: usize,
    pub to: usize,
    pub measurement: Pose,
    /// 3 by 3 or 6 by 6.
    pub information: DMatrix<f64>,
}

pub struct PoseGraph {
    /// In the order of their ids.
    pub poses: Vec<Pose>,
    pub edges: Vec<Edge>,
}

impl PoseGraph {
    pub fn is_3d(&self) -> bool {
        self.poses[0].len() == 7
    }
}

/// Ends the program with a message if there is no such file, or none with vertices and edges alone.
///
/// # Panics
///
/// If a line is not as expected.
pub fn read(path: &str) -> PoseGraph {
    let text =
        std::fs::read_to_string(path).unwrap_or_else(|error| end(&format!("{path}: {error}")));
    let mut poses = std::collections::BTreeMap::new();
    let mut edges = Vec::new();
    for line in text.lines() {
        let mut words = line.split_whitespace();
        let Some(tag) = words.next() else { continue };
        let (length, ids) = match tag {
            "VERTEX_SE2" => (3, 1),
            "EDGE_SE2" => (3, 2),
            "VERTEX_SE3:QUAT" => (7, 1),
            "EDGE_SE3:QUAT" => (7, 2),
            _ if tag.starts_with('#') => continue,
            _ => end(&format!("{path}: {tag} lines are not for this program")),
        };
        let id: Vec<usize> =
            words.by_ref().take(ids).map(|word| word.parse().expect(line)).collect();
        let x: Vec<f64> = words.map(|word| word.parse().expect(line)).collect();
        let mut pose = Pose::from_column_slice(&x[..length]);
        if length == 7 {
            pose.rows_mut(3, 4).normalize_mut();
        }
        if ids == 1 {
            poses.insert(id[0], pose);
        } else {
            let information = symmetric(&x[length..], if length == 3 { 3 } else { 6 });
            edges.push(Edge { from: id[0], to: id[1], measurement: pose, information });
        }
    }
    if poses.is_empty() {
        end(&format!("{path}: no vertices to start from"));
    }
    let number: std::collections::HashMap<usize, usize> =
        poses.keys().enumerate().map(|(number, &id)| (id, number)).collect();
    for edge in &mut edges {
        (edge.from, edge.to) = (number[&edge.from], number[&edge.to]);
    }
    PoseGraph { poses: poses.into_values().collect(), edges }
}

fn end(message: &str) -> ! {
    eprintln!("{message}");
    std::process::exit(1)
}

fn symmetric(upper: &[f64], n: usize) -> DMatrix<f64> {
    let mut entries = upper.iter();
    let mut matrix = DMatrix::zeros(n, n);
    for row in 0..n {
        for column in row..n {
            matrix[(row, column)] = *entries.next().expect("a whole matrix");
            matrix[(column, row)] = matrix[(row, column)];
        }
    }
    matrix
}
