"""How long a browser takes to open a report: its own timing, and its processor time in a page's thread.

    python studies/performance/report_loads.py REPORT.html [...]

Needs chromium. The load event comes when everything of the page is there and laid out once; processor time is what the
thread spent on it, and says more than the clock where the machine is busy.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tests" / "reporting"))
from browser import browser

LOADED = "performance.getEntriesByType('navigation')[0].loadEventEnd"


def main() -> None:
    for path in map(Path, sys.argv[1:]):
        with tempfile.TemporaryDirectory() as profile, browser(Path(profile)) as page:
            page._ask("Performance.enable", timeDomain="threadTicks")
            page.show(path.resolve(), 1400)
            loaded = page.value(f"new Promise(done => setTimeout(() => done({LOADED}), 500))")
            used = {m["name"]: m["value"] for m in page._ask("Performance.getMetrics")["metrics"]}
        sys.stdout.write(f"{path.name}: {path.stat().st_size / 1e6:.1f} MB, load event after {loaded / 1000:.2f} s, "
                         f"{used['TaskDuration']:.2f} s of processor time\n")


if __name__ == "__main__":
    main()
