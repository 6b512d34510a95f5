#!/usr/bin/env python3
"""Writes the Gauss-Newton system of a 2D g2o file at its vertices, as MatrixMarket files.

usage: python hessian.py FILE.g2o MATRIX.mtx RIGHT_SIDE.mtx          (pip install numpy)

J^T I J, lower triangle, and -J^T I r of the edges, three rows a pose (x, y, theta; perturbed on the
right), in the order of their ids, with 1e4 on the first pose's diagonal. For timing solvers: the
residual is translation and angle of z^-1 xi^-1 xj, whose Hessian has the pattern of the logarithm's
and nearly its numbers.
"""
import sys

import numpy as np

TURN = np.array([[0.0, -1.0], [1.0, 0.0]])


def rotation(angle):
    return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])


def read(path):
    """Poses by id, and edges (i, j, measurement, information)."""
    poses, edges = {}, []
    for line in open(path):
        fields = line.split()
        if fields and fields[0] == "VERTEX_SE2":
            poses[int(fields[1])] = np.array(fields[2:5], float)
        elif fields and fields[0] == "EDGE_SE2":
            information = np.zeros((3, 3))
            information[np.triu_indices(3)] = np.array(fields[6:12], float)
            information += np.triu(information, 1).T
            edges.append((int(fields[1]), int(fields[2]), np.array(fields[3:6], float), information))
        elif fields and fields[0][0] != "#":
            sys.exit(f"{path}: {fields[0]} lines are not for this script")
    return poses, edges


def linearized(xi, xj, z):
    """Residual and its Jacobians."""
    unmeasured, seen = rotation(z[2]).T, rotation(xi[2]).T @ (xj[:2] - xi[:2])
    angle = xj[2] - xi[2] - z[2]
    residual = np.append(unmeasured @ (seen - z[:2]), np.arctan2(np.sin(angle), np.cos(angle)))
    by_i, by_j = -np.eye(3), np.eye(3)
    by_i[:2, :2], by_i[:2, 2] = -unmeasured, -unmeasured @ TURN @ seen
    by_j[:2, :2] = rotation(angle)
    return residual, by_i, by_j


def main():
    if len(sys.argv) != 4:
        sys.exit("usage: python hessian.py FILE.g2o MATRIX.mtx RIGHT_SIDE.mtx")
    poses, edges = read(sys.argv[1])
    place = {pose: n for n, pose in enumerate(sorted(poses))}
    blocks = {(n, n): np.zeros((3, 3)) for n in range(len(poses))}
    blocks[0, 0] += 1e4 * np.eye(3)
    right = np.zeros(3 * len(poses))
    for i, j, z, information in edges:
        residual, *jacobians = linearized(poses[i], poses[j], z)
        ends = list(zip((place[i], place[j]), jacobians))
        for row, by_row in ends:
            right[3 * row : 3 * row + 3] -= by_row.T @ information @ residual
            for column, by_column in ends:
                if row >= column:
                    block = blocks.setdefault((row, column), np.zeros((3, 3)))
                    block += by_row.T @ information @ by_column
    entries = [
        (3 * row + r + 1, 3 * column + c + 1, float(block[r, c]))
        for (row, column), block in sorted(blocks.items())
        for r in range(3)
        for c in range(3)
        if 3 * row + r >= 3 * column + c
    ]
    with open(sys.argv[2], "w") as file:
        print("%%MatrixMarket matrix coordinate real symmetric", file=file)
        print(len(right), len(right), len(entries), file=file)
        file.writelines(f"{row} {column} {entry!r}\n" for row, column, entry in entries)
    with open(sys.argv[3], "w") as file:
        print("%%MatrixMarket matrix array real general", file=file)
        print(len(right), 1, file=file)
        file.writelines(f"{float(entry)!r}\n" for entry in right)


main()
