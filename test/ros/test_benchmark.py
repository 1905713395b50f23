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
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from processes import TellingCase

from dyknow_benchmark.chains import KINDS

PKG, NAME = "dyknow", "benchmark"
TIME_LIMIT = 150.0


def processes_with(text):
    """Pids whose environment has ``text``."""
    found = []
    for each in Path("/proc").iterdir():
        if each.name.isdigit():
            try:
                environment = (each / "environ").read_bytes()
            except OSError:
                continue
            if text.encode() in environment:
                found.append(int(each.name))
    return found


class BenchmarkTest(TellingCase):
    def setUp(self):
        directory = tempfile.TemporaryDirectory()
        self.addCleanup(directory.cleanup)
        self.out = Path(directory.name) / "out"

    def command(self, *arguments):
        return [sys.executable, "-m", "dyknow_benchmark", *map(str, arguments)]

    def measure(self, *arguments, name=None):
        name = name or arguments[0]
        mark = f"{self.id()} {name}"
        marked = {**os.environ, "DYKNOW_BENCHMARK_TEST": mark}
        done = subprocess.run(
            self.command(*arguments, "--out", self.out / name),
            env=marked,
            capture_output=True,
            text=True,
            timeout=TIME_LIMIT,
        )
        self.assertEqual(done.returncode, 0, done.stdout + done.stderr)
        self.assertEqual(processes_with(f"DYKNOW_BENCHMARK_TEST={mark}\0"), [])
        return done.stdout

    def rows(self, name, measurement=None):
        with (self.out / (measurement or name) / f"{name}.csv").open(newline="") as file:
            return list(csv.DictReader(file))

    def test_small_ones_side_by_side(self):
        """Their numbers are meaningless then, but the files still have to be right."""
        commands = {
            # Without a name, the chain is measured.
            "every_kind": (
                *("--kinds", *KINDS, "--hops", 1, 3),
                *("--rate", 200, "--messages", 6, "--repeats", 2),
            ),
            "images": ("images", "--hops", 2, "--messages", 4, "--sizes", "640x480", "1920x1080"),
            "busy": ("busy", "--hops", 2, "--messages", 4),
            "outside": ("outside", "--hops", 3, "--messages", 4, "--listened", 0, 2),
            "footprint": ("footprint", "--nodelets", 5, "--nodes", 2),
            "scripts": ("scripts", "--messages", 4, "--scripts", 3, "--size", "320x240"),
            "cpp": ("cpp", "--hops", 3, "--pairs", 2, "--switches", 4),
            "idle": ("idle", "--nodelets", 3, "--seconds", 1),
            "model": ("model", "--nodelets", 5),
            "recover": ("recover", "--nodelets", 3, "--kills", 1),
            "window": ("window", "--nodelets", 4, "--restored", 4),
        }
        with ThreadPoolExecutor(4) as pool:
            runs = {
                name: pool.submit(self.measure, *command, name=name)
                for name, command in commands.items()
            }
        files = {"every_kind": "figure4", "cpp": "cpp_chains"}
        for name, run in runs.items():
            with self.subTest(name):
                self.assertIn("busy_percent", run.result())
                getattr(self, f"check_{name}")(self.rows(files.get(name, name), name))

    def check_every_kind(self, rows):
        self.assertEqual(
            list(rows[0]),
            ["kind", "hops", "messages", "lost", "mean_us", "median_us", "p99_us", "max_us"],
        )
        self.assertEqual(
            [(row["kind"], row["hops"]) for row in rows],
            [(kind, hops) for kind in KINDS for hops in ("1", "3")],
        )
        for row in rows:
            self.assertEqual((row["messages"], row["lost"]), ("6", "0"), row)
            self.assertGreater(float(row["mean_us"]), 0.0, row)
        overhead = self.rows("overhead", "every_kind")
        self.assertEqual(list(overhead[0]), ["hops", "pairs", "median_us", "low_us", "high_us"])
        self.assertEqual(
            [(row["hops"], row["pairs"]) for row in overhead], [("1", "20"), ("3", "20")]
        )
        for suffix in ("png", "svg"):
            self.assertGreater(
                (self.out / "every_kind" / f"figure4.{suffix}").stat().st_size, 1000
            )

    def check_scripts(self, rows):
        self.assertEqual([row["kind"] for row in rows], ["script", "node", "dyknow"])
        self.assertTrue(all((row["messages"], row["lost"]) == ("4", "0") for row in rows), rows)
        (loads,) = self.rows("script_loads", "scripts")
        self.assertGreater(float(loads["median_load_ms"]), 0.0)

    def check_images(self, rows):
        self.assertEqual(
            [(row["payload"], row["lost"]) for row in rows],
            [("time", "0"), ("640x480", "0"), ("1920x1080", "0")],
        )
        (target,) = self.rows("targets", "images")
        self.assertIn("median with images of 1920x1080", target["what"])

    def check_busy(self, rows):
        self.assertEqual(
            [(row["burner"], row["lost"]) for row in rows],
            [("none", "0"), ("same manager", "0"), ("own manager", "0")],
        )

    def check_outside(self, rows):
        self.assertEqual(
            [(row["listened"], row["lost"]) for row in rows], [("0", "0"), ("2", "0")]
        )

    def check_footprint(self, rows):
        of = {row["kind"]: row for row in rows}
        for kind, row in of.items():
            processes = "0" if kind in ("dyknow", "nodelet", "cpp_nodelet") else "3"
            self.assertEqual(row["processes"], processes, row)
        self.assertGreater(float(of["node"]["kib_each"]), float(of["dyknow"]["kib_each"]))

    def test_rewire_loses_and_doubles_nothing(self):
        self.measure("rewire", "--switches", 40, "--rate", 500)
        rows = self.rows("rewire")
        self.assertEqual([row["port"] for row in rows], ["in", "out"])
        for row in rows:
            self.assertEqual((row["switches"], row["lost"], row["doubled"]), ("20", "0", "0"), row)
            self.assertGreater(int(row["seen"]), 0, row)

    def test_nothing_leaks(self):
        self.measure("leak", "--cycles", 5)
        rows = {row["what"]: row for row in self.rows("leak")}
        for what in ("file_descriptors", "threads", "registrations"):
            self.assertLessEqual(int(rows[what]["after"]), int(rows[what]["before"]), rows)

    def check_cpp(self, rows):
        self.assertEqual(
            [(row["chain"], row["lost"]) for row in rows],
            [("cpp_nodelet", "0"), ("cpp_live", "0"), ("mixed", "0")],
        )
        differences = [row["pairs"] for row in self.rows("cpp_ports", "cpp")]
        switches = [row["switches"] for row in self.rows("cpp_switches", "cpp")]
        self.assertEqual((differences, switches), (["2", "2"], ["4", "4"]))

    def check_idle(self, rows):
        self.assertEqual([row["nodelets"] for row in rows], ["3"])

    def check_model(self, rows):
        self.assertEqual([row["count"] for row in rows], ["5", "50"])
        self.assertIn("spawn, median", self.rows("targets", "model")[0]["what"])

    def check_recover(self, rows):
        self.assertEqual([(row["nodelets"], row["kills"]) for row in rows], [("3", "1")])
        self.assertGreater(float(rows[0]["median_s"]), 0.0)
        self.assertIn("all streams back", self.rows("targets", "recover")[0]["what"])

    def check_window(self, rows):
        done = [row["what"] for row in rows if row["manager"] == "real"]
        self.assertEqual(
            done[:3], ["open", "nodelet manager killed", "both managers killed"], rows
        )
        self.assertGreater(min(float(row["longest_ms"]) for row in rows), 0.0)

    def test_failover(self):
        self.assertIn("silent: replaced", self.measure("failover", "--failures", 1))
        rows = self.rows("failover")
        self.assertEqual([row["failures"] for row in rows], ["1", "1", "1"])
        self.assertGreater(min(float(row["median_s"]) for row in rows), 0.0)

    def test_an_interrupted_measurement_ends_its_processes(self):
        mark = f"DYKNOW_BENCHMARK_TEST={self.id()}"
        name, _, value = mark.partition("=")
        process = subprocess.Popen(
            self.command("idle", "--nodelets", 1, "--seconds", 600),
            env={**os.environ, name: value},
            stderr=subprocess.PIPE,
            text=True,
        )
        try:
            while "watching" not in process.stderr.readline():
                self.assertIsNone(process.poll())
            process.send_signal(signal.SIGTERM)
            process.communicate(timeout=30)
            self.assertEqual(process.returncode, 130)
            self.assertEqual(processes_with(mark), [])
        finally:
            if process.poll() is None:
                process.kill()
                process.communicate()


if __name__ == "__main__":
    import rostest

    rostest.rosrun(PKG, NAME, BenchmarkTest)
