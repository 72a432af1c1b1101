"""A day at the rig from Python: recipe and specification, the parts of a CSV file, and a row for each part at the end.

Usage: python by_python.py PARTS.csv > rows.csv     in the folder where `ridged serve` runs
"""

import csv
import sys
from pathlib import Path

import ridged

RECIPE = {
    "name": "PX-1204 rev C",
    "plan": {"preset": "paper", "repeats": 1},
    "fit": {"variant": "sawtooth"},
    "material": {"eta": 1.54, "eta_std": 0.005},
}
SPECIFICATION = {"name": "drawing 4711 B", "limits": {"theta_r_deg": {"lower": 9.0, "upper": 11.0}}}


def measure(lab: ridged.Lab, parts: list[dict[str, str]]) -> list[ridged.Scan]:
    """Measures parts by the queue and returns their scans, fitted and judged."""
    recipe = lab.add_recipe(RECIPE)
    specification = lab.add_specification(SPECIFICATION)
    orders = lab.queue.add(parts, recipe=recipe["name"], specification=specification["name"])
    lab.queue.start()
    # On a real rig leave `on_step` out: the program then asks for each part.
    lab.queue.wait(on_step=ridged.confirm)
    done = [lab.queue.order(order["id"]) for order in orders]
    scans = [lab.scan(order["scan_id"]) for order in done if order["scan_id"] is not None]
    for scan in scans:
        print(f"{scan.sample_name}: {scan.fit.theta_r}, {scan.verdict}", file=sys.stderr)
    return scans


if __name__ == "__main__":
    with ridged.connect() as lab, Path(sys.argv[1]).open(newline="") as file:
        scans = measure(lab, list(csv.DictReader(file)))
        rows = lab.results(rows=True, sort="scan_id", limit=len(scans))
    writer = csv.DictWriter(sys.stdout, rows[0].keys())
    writer.writeheader()
    writer.writerows(rows)
