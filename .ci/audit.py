"""Known vulnerabilities of the locked versions: Python's by pip-audit, the dashboard's by npm. `make audit` runs it.

Exit code 0: none are known. 1: some are, and are listed. 2: a database could not be reached, so nothing is known.
"""

import json
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]
PATIENCE_S = 60
NONE, FOUND, UNREACHED = 0, 1, 2


def output_of(*command: str) -> tuple[str, str]:
    """Standard output, and the last line that tells what went wrong."""
    try:
        done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=PATIENCE_S)
    except subprocess.TimeoutExpired:
        return "", f"no answer within {PATIENCE_S} s"
    said = [line for line in done.stderr.splitlines() if line.strip()]
    return done.stdout, said[-1] if said else f"exit code {done.returncode}"


def python_parts() -> int:
    """Against PyPI's own advisories: the server that they are installed from, unless another index is set."""
    lock = ROOT / "requirements.lock"
    command = (sys.executable, "-m", "pip_audit", "-r", str(lock), "--no-deps", "--disable-pip", "--format", "json")
    output, problem = output_of(*command, "--progress-spinner", "off", "--timeout", "15")
    try:
        parts = json.loads(output)["dependencies"]
    except (ValueError, KeyError):
        return unreached("Python", problem)
    skipped = [f"{part['name']} ({part['skip_reason']})" for part in parts if "skip_reason" in part]
    found = [
        f"{part['name']} {part['version']}: {each['id']}, mended in {', '.join(each['fix_versions']) or 'none yet'}"
        for part in parts
        for each in part.get("vulns", ())
    ]
    result = tell("Python", len(parts) - len(skipped), found)
    return unreached("Python", f"{len(skipped)} parts, such as {skipped[0]}") if skipped and not found else result


def dashboard_parts() -> int:
    options = ("--prefix", "frontend", "--package-lock-only", "--json", "--fetch-retries", "0")
    output, problem = output_of("frontend/npm.sh", "audit", *options, "--fetch-timeout", "20000")
    try:
        answer = json.loads(output)
        parts, faults = answer["metadata"]["dependencies"]["total"], answer["vulnerabilities"]
    except ValueError:
        return unreached("dashboard", problem)
    except KeyError:
        return unreached("dashboard", answer.get("message", problem))
    return tell("dashboard", parts, [f"{name} {each['range']}: {each['severity']}" for name, each in faults.items()])


def tell(what: str, parts: int, found: list[str]) -> int:
    print(f"audit, {what}: {parts} parts, {len(found)} known vulnerabilities")
    for line in found:
        print(f"  {line}")
    return FOUND if found else NONE


def unreached(what: str, problem: str) -> int:
    print(f"audit, {what}: NOT DONE, the database of vulnerabilities has not answered ({problem.strip()})")
    return UNREACHED


if __name__ == "__main__":
    results = {python_parts(), dashboard_parts()}
    if UNREACHED in results:
        print("audit: nothing is known of what is said to be not done. Run `make audit` again with the network there.")
    sys.exit(FOUND if FOUND in results else max(results))
