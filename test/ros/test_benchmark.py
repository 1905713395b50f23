#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Every measurement, with tiny numbers: the files have the right format and nothing is left."""

from __future__ import annotations

import csv
import os
import signal
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor

import psutil
from processes import TellingCase, run

from dyknow_benchmark.chains import KINDS

TIME_LIMIT = 900.0
#: Variable of all processes of a measurement.
MARK = "DYKNOW_BENCHMARK_TEST"


def left_of(measurement):
    """Commands of its processes that run still."""
    every = psutil.process_iter(["environ", "cmdline"])
    marked = [each.info for each in every if (each.info["environ"] or {}).get(MARK) == measurement]
    return [info["cmdline"] for info in marked]


def zeros(*names):
    return [(name, "0") for name in names]


class BenchmarkTest(TellingCase):
    def setUp(self):
        self.out = self.make_folder() / "out"

    def command(self, *arguments):
        return [sys.executable, "-m", "dyknow_benchmark", *map(str, arguments)]

    def measure(self, *arguments, name=None):
        name = name or arguments[0]
        done = subprocess.run(
            self.command(*arguments, "--out", self.out / name),
            env={**os.environ, MARK: name},
            capture_output=True,
            text=True,
            timeout=TIME_LIMIT,
        )
        self.assertEqual(done.returncode, 0, done.stdout + done.stderr)
        self.assertEqual(left_of(name), [])
        return done.stdout

    def column(self, measurement, file, *names):
        """The values in a column of a file, or in several."""
        with (self.out / measurement / f"{file}.csv").open(newline="") as lines:
            rows = list(csv.DictReader(lines))
        self.assertTrue(rows, file)
        values = [tuple(row[name] for name in names) for row in rows]
        return [value for (value,) in values] if len(names) == 1 else values

    def test_small_ones_side_by_side(self):
        """Their numbers are meaningless then, but the files still have to be right."""
        commands = {
            # Without a name, the chain is measured.
            "every_kind": (
                *("--kinds", *KINDS, "--hops", 1, 3),
                *("--rate", 200, "--messages", 6),
            ),
            "images": ("images", "--hops", 2, "--messages", 4, "--sizes", "640x480", "1920x1080"),
            "busy": ("busy", "--hops", 2, "--messages", 4),
            "outside": ("outside", "--hops", 3, "--messages", 4, "--listened", 0, 2),
            "footprint": ("footprint", "--nodelets", 5, "--nodes", 2),
            "scripts": ("scripts", "--messages", 4, "--scripts", 3, "--size", "320x240"),
            "cpp": ("cpp", "--hops", 3, "--pairs", 2, "--switches", 4),
            "model": ("model", "--nodelets", 5),
            "recover": ("recover", "--nodelets", 3, "--kills", 1),
            "window": ("window", "--nodelets", 4),
            "rewire": ("rewire", "--switches", 40, "--rate", 500),
            "failover": ("failover", "--failures", 1),
        }
        with ThreadPoolExecutor(4) as pool:
            runs = {
                name: pool.submit(self.measure, *command, name=name)
                for name, command in commands.items()
            }
        for name, measured in runs.items():
            with self.subTest(name):
                self.assertIn("busy_percent", measured.result())
        hops = [(kind, each, "6", "0") for kind in KINDS for each in ("1", "3")]
        for measurement, file, names, values in (
            ("every_kind", "figure4", "kind hops messages lost", hops),
            ("every_kind", "overhead", "hops pairs", [("1", "20"), ("3", "20")]),
            ("images", "images", "payload lost", zeros("time", "640x480", "1920x1080")),
            ("busy", "busy", "burner lost", zeros("none", "same manager", "own manager")),
            ("outside", "outside", "listened lost", zeros("0", "2")),
            ("scripts", "scripts", "kind lost", zeros("script", "node", "dyknow")),
            ("cpp", "cpp_ports", "pairs", ["2", "2"]),
            ("cpp", "cpp_switches", "switches", ["4", "4"]),
            ("model", "model", "count", ["5", "50"]),
            ("recover", "recover", "nodelets kills", [("3", "1")]),
            ("failover", "failover", "failures", ["1", "1", "1"]),
            (
                *("rewire", "rewire", "port switches lost doubled"),
                [(port, "20", "0", "0") for port in ("in", "out")],
            ),
        ):
            with self.subTest(measurement, file=file):
                self.assertEqual(self.column(measurement, file, *names.split()), values)
        for measurement, file, name in (
            ("every_kind", "figure4", "mean_us"),
            ("recover", "recover", "median_s"),
            ("failover", "failover", "median_s"),
            ("window", "window", "longest_ms"),
            ("rewire", "rewire", "seen"),
        ):
            with self.subTest(measurement, column=name):
                self.assertGreater(min(map(float, self.column(measurement, file, name))), 0.0)
        for measurement, target in (
            ("images", "median with images of 1920x1080"),
            ("model", "spawn, median"),
            ("recover", "all streams back"),
        ):
            self.assertIn(target, self.column(measurement, "targets", "what")[0])
        self.assertIn("silent: replaced", runs["failover"].result())
        for suffix in ("png", "svg"):
            picture = self.out / "every_kind" / f"figure4.{suffix}"
            self.assertGreater(picture.stat().st_size, 1000)
        for kind, processes in self.column("footprint", "footprint", "kind", "processes"):
            alone = kind not in ("dyknow", "nodelet", "cpp_nodelet")
            self.assertEqual(processes, "3" if alone else "0", kind)
        each = dict(self.column("footprint", "footprint", "kind", "kib_each"))
        self.assertGreater(float(each["node"]), float(each["dyknow"]))
        done = self.column("window", "window", "what")[:4]
        self.assertEqual(done, ["open", "idle", "nodelet manager killed", "both managers killed"])

    def test_an_interrupted_measurement_ends_its_processes(self):
        for name, at, number in (
            ("model", "listening", signal.SIGTERM),
            ("window", "idle", signal.SIGINT),  # while Qt runs
        ):
            with self.subTest(name):
                measured = self.command(name, "--nodelets", 1)
                process = self.run_process("env", f"{MARK}=interrupted", *measured)
                process.wait_for(at)
                process.stop(number)
                self.assertEqual(process.exit_code(30.0), 130, process.output)
                self.assertNotIn("Traceback", process.output)
                self.assertEqual(left_of("interrupted"), [])


if __name__ == "__main__":
    run(is_node=False)
