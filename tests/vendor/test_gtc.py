"""The budget of a fit against GTC, the GUM Tree Calculator: the same parts give the same standard
uncertainty and the same effective degrees of freedom."""

import json
import math
import os
import subprocess
import unittest

import GTC

RIDGED = os.environ.get("RIDGED_BIN", "target/debug/ridged")
SERIES = "tests/data/series/paper-rig-full"


class Budget(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        done = subprocess.run(
            [RIDGED, "fit", SERIES, "--json"], capture_output=True, check=True, timeout=300
        )
        cls.report = json.loads(done.stdout)

    def combined(self, parameter):
        freedom = self.report["freedom"]
        parts = parameter["budget"].items()
        return sum(
            GTC.ureal(0, part, freedom.get(name, math.inf), label=name)
            for name, part in parts
            if part > 0
        )

    def known(self):
        for name, parameter in self.report["parameters"].items():
            if parameter["identifiable"]:
                yield name, parameter

    def test_parts_combine_to_the_standard_uncertainty(self):
        self.assertGreaterEqual(sum(1 for _ in self.known()), 6)
        for name, parameter in self.known():
            with self.subTest(name):
                std = GTC.uncertainty(self.combined(parameter))
                self.assertAlmostEqual(std / parameter["std"], 1, places=12)
                expanded = parameter["coverage_factor"] * std
                self.assertAlmostEqual(expanded / parameter["expanded"], 1, places=12)

    def test_effective_degrees_of_freedom_are_those_of_welch_and_satterthwaite(self):
        for name, parameter in self.known():
            with self.subTest(name):
                freedom = GTC.dof(self.combined(parameter))
                stated = parameter["degrees_of_freedom"]
                if stated is None:
                    self.assertGreaterEqual(freedom, 1000)
                else:
                    # GTC itself answers with one digit less than a double has where parts are many.
                    self.assertAlmostEqual(freedom / stated, 1, places=9)


if __name__ == "__main__":
    unittest.main()
