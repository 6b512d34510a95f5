"""Reads pose graphs for the GTSAM scripts: g2o (EDGE_SE2, EDGE_SE3:QUAT) and iSAM text.

Quaternions are normalized, which GTSAM does not do, and matrices are taken as Evergraph takes them:
information in g2o files, its upper-triangular square root in iSAM's.
"""
import functools
import resource
import sys

import gtsam
import numpy as np

ROTATION_FIRST = [3, 4, 5, 0, 1, 2]


class PoseGraph:
    """Poses are numbered 0, 1, ... by id."""

    def __init__(self, path):
        edges, vertices = [], {}
        for line in open(path):
            fields = line.split()
            if not fields or fields[0][0] == "#":
                continue
            if fields[0] in ("VERTEX_SE2", "VERTEX_SE3:QUAT"):
                vertices[int(fields[1])] = pose([float(field) for field in fields[2:]])
            elif fields[0] in ("EDGE_SE2", "EDGE_SE3:QUAT", "ODOMETRY", "EDGE2", "EDGE3"):
                edges.append(edge(fields))
            else:
                sys.exit(f"{path}: {fields[0]} lines are not for this script")
        #: The file's id of each pose.
        self.ids = sorted({i for e in edges for i in e[:2]})
        number = {pose: n for n, pose in enumerate(self.ids)}
        #: (i, j, measurement, noise)
        self.edges = [(number[i], number[j], z, noise) for i, j, z, noise in edges]
        #: The file's own estimate, pose by pose, or nothing.
        self.start = [vertices[i] for i in self.ids] if vertices else []
        if isinstance(edges[0][2], gtsam.Pose3):
            self.pose, self.between, prior, dim = gtsam.Pose3, gtsam.BetweenFactorPose3, gtsam.PriorFactorPose3, 6
        else:
            self.pose, self.between, prior, dim = gtsam.Pose2, gtsam.BetweenFactorPose2, gtsam.PriorFactorPose2, 3
        #: Holds the first pose where it is told to be.
        self.prior = lambda at: prior(0, at, gtsam.noiseModel.Isotropic.Sigma(dim, 0.01))

    def write_vertices(self, path, values):
        """The estimates as VERTEX lines of g2o."""
        with open(path, "w") as file:
            for n, i in enumerate(self.ids):
                if self.pose is gtsam.Pose2:
                    x = values.atPose2(n)
                    print("VERTEX_SE2", i, *map(float, (x.x(), x.y(), x.theta())), file=file)
                else:
                    x = values.atPose3(n)
                    q = x.rotation().toQuaternion()
                    rotation = map(float, (q.x(), q.y(), q.z(), q.w()))
                    print("VERTEX_SE3:QUAT", i, *map(float, x.translation()), *rotation, file=file)


def edge(fields):
    tag, i, j = fields[0], int(fields[1]), int(fields[2])
    x = [float(field) for field in fields[3:]]
    if tag in ("EDGE_SE2", "ODOMETRY", "EDGE2"):
        return i, j, pose(x[:3]), noise(tag, tuple(x[3:9]))
    if tag == "EDGE_SE3:QUAT":
        return i, j, pose(x[:7]), noise(tag, tuple(x[7:28]))
    z = gtsam.Pose3(gtsam.Rot3.RzRyRx(*x[3:6]), np.array(x[:3]))
    return i, j, z, noise(tag, tuple(x[6:27]))


@functools.cache
def noise(tag, entries):
    """One object for all edges of the same weight, as programs that use GTSAM have."""
    model = gtsam.noiseModel.Gaussian
    if tag == "EDGE_SE2":
        return model.Information(symmetric(entries, 3), True)
    if tag == "EDGE_SE3:QUAT":
        return model.Information(rotation_first(symmetric(entries, 6)), True)
    if tag == "EDGE3":
        root = upper(entries, 6)
        return model.Information(rotation_first(root.T @ root), True)
    return model.SqrtInformation(upper(entries, 3), True)


def pose(x):
    if len(x) == 3:
        return gtsam.Pose2(*x)
    q = np.array(x[3:7]) / np.linalg.norm(x[3:7])
    return gtsam.Pose3(gtsam.Rot3.Quaternion(q[3], q[0], q[1], q[2]), np.array(x[:3]))


def upper(entries, n):
    m = np.zeros((n, n))
    m[np.triu_indices(n)] = entries
    return m


def symmetric(entries, n):
    m = upper(entries, n)
    return m + np.triu(m, 1).T


def rotation_first(information):
    """From Evergraph's tangent order to GTSAM's."""
    return information[np.ix_(ROTATION_FIRST, ROTATION_FIRST)]


def peak_rss_mb():
    """As Evergraph measures it; getrusage() would include the parent that this process was before exec."""
    try:
        with open("/proc/self/status") as status:
            return next(int(line.split()[1]) for line in status if line.startswith("VmHWM")) / 1024
    except OSError:
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
