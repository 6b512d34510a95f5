// Reads the pose graphs of g2o files, for the peers that are written in C++.
//
// Quaternions are normalized and matrices are taken as they stand (translation before rotation,
// rotation in angle units), as Evergraph and the GTSAM scripts do.
#pragma once

#include <Eigen/Dense>
#include <fstream>
#include <map>
#include <sstream>
#include <stdexcept>
#include <string>
#include <vector>

namespace g2o {

// `x y theta`, or `x y z qx qy qz qw` with a unit quaternion.
using Pose = std::vector<double>;

struct Edge {
  int from, to;  // places in `poses`
  Pose measurement;
  Eigen::MatrixXd information;  // 3 by 3 or 6 by 6
};

struct PoseGraph {
  std::vector<Pose> poses;  // in the order of their ids
  std::vector<Edge> edges;
  bool is_3d() const { return poses.front().size() == 7; }
};

inline Pose read_pose(std::istream& words, size_t length) {
  Pose pose(length);
  for (double& x : pose) words >> x;
  if (length == 7) Eigen::Map<Eigen::Vector4d>(&pose[3]).normalize();
  return pose;
}

inline Eigen::MatrixXd read_symmetric(std::istream& words, int n) {
  Eigen::MatrixXd matrix(n, n);
  for (int row = 0; row < n; ++row) {
    for (int column = row; column < n; ++column) {
      words >> matrix(row, column);
      matrix(column, row) = matrix(row, column);
    }
  }
  return matrix;
}

inline PoseGraph read(const std::string& path) {
  std::ifstream file(path);
  if (!file) throw std::runtime_error(path + ": no such file");
  std::map<int, Pose> vertices;
  std::vector<Edge> edges;
  std::string line, tag;
  while (std::getline(file, line)) {
    std::istringstream words(line);
    if (!(words >> tag) || tag[0] == '#') continue;
    const bool is_3d = tag.find("SE3:QUAT") != std::string::npos;
    const size_t length = is_3d ? 7 : 3;
    if (tag == "VERTEX_SE2" || tag == "VERTEX_SE3:QUAT") {
      int id;
      words >> id;
      vertices[id] = read_pose(words, length);
    } else if (tag == "EDGE_SE2" || tag == "EDGE_SE3:QUAT") {
      Edge edge;
      words >> edge.from >> edge.to;
      edge.measurement = read_pose(words, length);
      edge.information = read_symmetric(words, is_3d ? 6 : 3);
      edges.push_back(edge);
    } else {
      throw std::runtime_error(path + ": " + tag + " lines are not for this program");
    }
    if (!words) throw std::runtime_error(path + ": too short: " + line);
  }
  if (vertices.empty()) throw std::runtime_error(path + ": no vertices to start from");
  PoseGraph graph;
  std::map<int, int> number;
  for (const auto& [id, pose] : vertices) {
    number[id] = graph.poses.size();
    graph.poses.push_back(pose);
  }
  for (Edge& edge : edges) {
    edge.from = number.at(edge.from);
    edge.to = number.at(edge.to);
  }
  graph.edges = std::move(edges);
  return graph;
}

}  // namespace g2o
