// Optimizes a g2o file with Ceres Solver, from the file's vertices to full convergence.
//
// usage: peer-ceres FILE.g2o log|example lm|gn
//
// The residual is Evergraph's, Log(z^-1 xi^-1 xj) (`log`), or that of Ceres' own pose graph examples
// (`example`): the translation in the frame of pose i less the measured one, and the angle (2D) or
// twice the vector part of the quaternion (3D). The second has another optimum. As in the examples:
// automatic derivatives, SPARSE_NORMAL_CHOLESKY on SuiteSparse, one thread, first pose constant.
// `lm` is Levenberg-Marquardt with default settings; `gn` starts it with the largest trust region,
// which makes it Gauss-Newton for as long as steps succeed: Ceres has no other, and its default
// damping delays the last digits. Tolerances are set to nothing: runs go on until rounding ends them.
//
// Prints one line of JSON: `trace` has the error over the seconds of Solve() so far, preprocessing
// included.
#include <ceres/ceres.h>
#include <ceres/rotation.h>

#include <cstdio>

#include "../g2o.hpp"

namespace {

constexpr int kMaxIterations = 100;
// Relative; where rounding ends a run's progress.
constexpr double kConverged = 1e-13;

template <typename T, int N>
using Vector = Eigen::Matrix<T, N, 1>;

template <typename T>
T wrapped(const T& angle) {
  const double turns = 2.0 * M_PI;
  return angle - turns * ceres::floor((angle + M_PI) / turns);
}

class Between2 {
 public:
  Between2(const g2o::Edge& edge, bool logarithm)
      : z_(edge.measurement.data()), logarithm_(logarithm), root_(edge.information.llt().matrixU()) {}

  template <typename T>
  bool operator()(const T* i, const T* j, T* residual) const {
    const Vector<T, 2> apart(j[0] - i[0], j[1] - i[1]);
    const Vector<T, 2> seen = Eigen::Rotation2D<T>(-i[2]) * apart;
    Vector<T, 2> t = seen - z_.head<2>().cast<T>();
    const T angle = wrapped(T(j[2] - i[2] - z_[2]));
    if (logarithm_) {
      // V^-1 of the translation in the measured frame.
      t = Eigen::Rotation2D<T>(T(-z_[2])) * t;
      const T half = 0.5 * angle;
      const T a = angle * angle < 1e-8 ? T(1.0 - half * half / 3.0) : T(half / ceres::tan(half));
      t = Vector<T, 2>(a * t[0] + half * t[1], a * t[1] - half * t[0]);
    }
    Eigen::Map<Vector<T, 3>> r(residual);
    r << t, angle;
    r = root_.template cast<T>() * r.eval();
    return true;
  }

 private:
  const Eigen::Vector3d z_;
  const bool logarithm_;
  const Eigen::Matrix3d root_;
};

class Between3 {
 public:
  Between3(const g2o::Edge& edge, bool logarithm)
      : z_t_(edge.measurement.data()),
        z_q_(edge.measurement.data() + 3),
        logarithm_(logarithm),
        root_(edge.information.llt().matrixU()) {}

  template <typename T>
  bool operator()(const T* i_t, const T* i_q, const T* j_t, const T* j_q, T* residual) const {
    using Quaternion = Eigen::Quaternion<T>;
    const Quaternion back = Eigen::Map<const Quaternion>(i_q).conjugate();
    const Vector<T, 3> apart = Eigen::Map<const Vector<T, 3>>(j_t) - Eigen::Map<const Vector<T, 3>>(i_t);
    const Quaternion unmeasured = z_q_.cast<T>().conjugate();
    const Quaternion q = unmeasured * (back * Eigen::Map<const Quaternion>(j_q));
    Vector<T, 3> t = back * apart - z_t_.cast<T>();
    Vector<T, 3> w = 2.0 * q.vec();
    if (logarithm_) {
      const T wxyz[4] = {q.w(), q.x(), q.y(), q.z()};
      ceres::QuaternionToAngleAxis(wxyz, w.data());
      // V^-1 t = t - w x t / 2 + c w x (w x t)
      const T squared = w.squaredNorm();
      const T angle = ceres::sqrt(squared);
      const T c = squared < 1e-8 ? T(1.0 / 12.0 + squared / 720.0)
                                 : T((1.0 - 0.5 * angle / ceres::tan(0.5 * angle)) / squared);
      t = unmeasured * t;
      const Vector<T, 3> cross = w.cross(t);
      t += c * w.cross(cross) - 0.5 * cross;
    }
    Eigen::Map<Vector<T, 6>> r(residual);
    r << t, w;
    r = root_.template cast<T>() * r.eval();
    return true;
  }

 private:
  const Eigen::Vector3d z_t_;
  const Eigen::Quaterniond z_q_;
  const bool logarithm_;
  const Eigen::Matrix<double, 6, 6> root_;
};

void build(g2o::PoseGraph& graph, bool logarithm, ceres::Problem& problem) {
  for (const g2o::Edge& edge : graph.edges) {
    double* i = graph.poses[edge.from].data();
    double* j = graph.poses[edge.to].data();
    if (graph.is_3d()) {
      auto* cost = new ceres::AutoDiffCostFunction<Between3, 6, 3, 4, 3, 4>(new Between3(edge, logarithm));
      problem.AddResidualBlock(cost, nullptr, i, i + 3, j, j + 3);
    } else {
      auto* cost = new ceres::AutoDiffCostFunction<Between2, 3, 3, 3>(new Between2(edge, logarithm));
      problem.AddResidualBlock(cost, nullptr, i, j);
    }
  }
  problem.SetParameterBlockConstant(graph.poses[0].data());
  if (graph.is_3d()) {
    for (g2o::Pose& pose : graph.poses) problem.SetManifold(pose.data() + 3, new ceres::EigenQuaternionManifold);
    problem.SetParameterBlockConstant(graph.poses[0].data() + 3);
  }
}

void run(const std::string& path, const std::string& residual, const std::string& method) {
  g2o::PoseGraph graph = g2o::read(path);
  ceres::Problem problem;
  build(graph, residual == "log", problem);

  ceres::Solver::Options options;
  options.linear_solver_type = ceres::SPARSE_NORMAL_CHOLESKY;
  options.sparse_linear_algebra_library_type = ceres::SUITE_SPARSE;
  options.num_threads = 1;
  if (method == "gn") options.initial_trust_region_radius = options.max_trust_region_radius;
  options.max_num_iterations = kMaxIterations;
  options.function_tolerance = kConverged;
  options.gradient_tolerance = 0.0;
  options.parameter_tolerance = 0.0;
  options.logging_type = ceres::SILENT;
  ceres::Solver::Summary summary;
  ceres::Solve(options, &problem, &summary);

  const char* status = ceres::TerminationTypeToString(summary.termination_type);
  std::printf("{\"peer\": \"Ceres\", \"version\": \"%s\", \"residual\": \"%s\", ", CERES_VERSION_STRING, residual.c_str());
  std::printf("\"method\": \"%s\", \"status\": \"%s\", \"trace\": [", method.c_str(), status);
  const char* separator = "";
  for (const ceres::IterationSummary& iteration : summary.iterations) {
    std::printf("%s[%.9f, %.17g]", separator, iteration.cumulative_time_in_seconds, iteration.cost);
    separator = ", ";
  }
  std::printf("]}\n");
}

}  // namespace

int main(int count, char** arguments) {
  google::InitGoogleLogging(arguments[0]);
  const std::string residual = count == 4 ? arguments[2] : "";
  const std::string method = count == 4 ? arguments[3] : "";
  if ((residual != "log" && residual != "example") || (method != "lm" && method != "gn")) {
    std::fprintf(stderr, "usage: peer-ceres FILE.g2o log|example lm|gn\n");
    return 2;
  }
  try {
    run(arguments[1], residual, method);
  } catch (const std::exception& error) {
    std::fprintf(stderr, "%s\n", error.what());
    return 1;
  }
}
