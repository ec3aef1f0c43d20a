#!/usr/bin/env python3
"""Small files that are wrong in one way each, for test_bad_input.sh: bad_files.py FOLDER"""
import struct
import sys

folder = sys.argv[1]


def tfx(name, strands, strand_count=None, point_count=None, offset=160):
    count = len(strands) if strand_count is None else strand_count
    points = len(strands[0]) if point_count is None else point_count
    data = struct.pack("<fIIIIIII", 4.0, count, points, offset, 0, 0, 0, 0).ljust(160, b"\0")
    for strand in strands:
        for i, point in enumerate(strand):
            data += struct.pack("<4f", *point, 0.0 if i == 0 else 1.0)
    write(name, data)
    return data


def write(name, data):
    with open(f"{folder}/{name}", "wb" if isinstance(data, bytes) else "w") as file:
        file.write(data)


nan = float("nan")
good = [[(0.01 * s, 0.2 + 0.01 * v, 0.0) for v in range(8)] for s in range(4)]
whole = tfx("good.tfx", good)
write("truncated.tfx", whole[:-40])
write("no_header.tfx", whole[:60])
write("empty.tfx", b"")
tfx("lying_count.tfx", good, strand_count=2**31)
tfx("lying_points.tfx", good, point_count=2**31 - 1)
tfx("lying_offset.tfx", good, offset=2**32 - 16)
tfx("zero_strands.tfx", good, strand_count=0)
tfx("nan_all.tfx", [[(nan, 0.0, 0.0)] * 8] * 2)
tfx("nan_one.tfx", good[:3] + [[(0.0, 0.2, 0.0)] * 3 + [(nan, 0.0, 0.0)] + [(0.0, 0.3, 0.0)] * 4])
tfx("zero_length.tfx", good[:3] + [[(0.0, 0.2, 0.0)] * 8])
tfx("one_vertex.tfx", [[strand[0]] for strand in good])

bvh = """HIERARCHY
ROOT Hips
{
  OFFSET 0 0 0
  CHANNELS 6 Xposition Yposition Zposition Zrotation Yrotation Xrotation
  JOINT %s
  {
    OFFSET 0 5 0
    CHANNELS 3 Zrotation Yrotation Xrotation
    End Site
    {
      OFFSET 0 5 0
    }
  }
}
MOTION
Frames: 2
Frame Time: .0083333
0 0 0 0 0 0 0 0 0
0 0 0 1 2 3 4 5 6
"""
write("truncated.bvh", (bvh % "Head")[:-20])
write("lying.bvh", (bvh % "Head").replace("Frames: 2", "Frames: 2000000000"))
write("words.bvh", (bvh % "Head").replace("1 2 3", "1 two 3"))
write("nan.bvh", (bvh % "Head").replace("1 2 3", "1 nan 3"))
write("other_joints.bvh", (bvh % "Tail").replace("Hips", "Trunk"))
write("broken.asf", ":version 1.10\n:root\n order TX TY\n")
write("broken.amc", ":FULLY-SPECIFIED\n:DEGREES\n1\nroot 0 0\n")
