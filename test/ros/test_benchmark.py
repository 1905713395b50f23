#!/usr/bin/env python3
"""Every measurement, with tiny numbers: the files have the promised shape and nothing is left."""

from __future__ import annotations

import csv
import os
import signal
import subprocess
import sys
import tempfile
import unittest
from pathlib import Path

from dyknow.benchmark.kinds import KINDS

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


class BenchmarkTest(unittest.TestCase):
    def setUp(self):
        directory = tempfile.TemporaryDirectory()
        self.addCleanup(directory.cleanup)
        self.out = Path(directory.name) / "out"

    def command(self, *arguments):
        return [sys.executable, "-m", "dyknow.benchmark", *map(str, arguments)]

    def measure(self, *arguments):
        marked = {**os.environ, "DYKNOW_BENCHMARK_TEST": self.id()}
        done = subprocess.run(
            self.command(*arguments, "--out", self.out),
            env=marked,
            capture_output=True,
            text=True,
            timeout=TIME_LIMIT,
        )
        self.assertEqual(done.returncode, 0, done.stdout + done.stderr)
        self.assertEqual(processes_with(f"DYKNOW_BENCHMARK_TEST={self.id()}"), [])
        return done.stdout

    def rows(self, name):
        with (self.out / f"{name}.csv").open(newline="") as file:
            return list(csv.DictReader(file))

    def test_chain_of_every_kind(self):
        self.measure("chain", "--hops", 1, 3, "--rate", 50, "--messages", 6, "--repeats", 2)
        rows = self.rows("figure4")
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
        overhead = self.rows("overhead")
        self.assertEqual(list(overhead[0]), ["hops", "pairs", "median_us", "low_us", "high_us"])
        self.assertEqual(
            [(row["hops"], row["pairs"]) for row in overhead], [("1", "20"), ("3", "20")]
        )
        for suffix in ("png", "svg"):
            self.assertGreater((self.out / f"figure4.{suffix}").stat().st_size, 1000)

    def test_images(self):
        self.measure("images", "--hops", 2, "--messages", 4)
        rows = self.rows("images")
        self.assertEqual(
            [(row["payload"], row["lost"]) for row in rows], [("time", "0"), ("image", "0")]
        )

    def test_throughput(self):
        self.measure("throughput", "--hops", 2, "--seconds", 0.3, "--repeats", 2)
        rows = self.rows("throughput")
        self.assertEqual(
            [(row["kind"], row["lost"]) for row in rows], [("dyknow", "0"), ("rospy", "0")]
        )
        self.assertTrue(all(float(row["median_hz"]) > 0 for row in rows), rows)

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

    def test_idle(self):
        self.measure("idle", "--nodelets", 3, "--seconds", 1)
        (row,) = self.rows("idle")
        self.assertEqual(row["nodelets"], "3")

    def test_the_system_at_scale(self):
        self.assertIn("spawn, median", self.measure("model", "--nodelets", 5))
        self.assertEqual([row["count"] for row in self.rows("model")], ["5", "50"])
        self.assertIn("plan, median", self.measure("library", "--transformations", 400))
        self.assertEqual(len(self.rows("library")), 4)
        self.assertIn("all streams back", self.measure("recover", "--nodelets", 3, "--kills", 1))
        (row,) = self.rows("recover")
        self.assertEqual((row["nodelets"], row["kills"]), ("3", "1"))
        self.assertGreater(float(row["median_s"]), 0.0)

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
