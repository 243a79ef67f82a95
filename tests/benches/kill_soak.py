#!/usr/bin/env python3
"""Random stages killed (`kill -9`) at random moments of plans and executions; the stack is never restarted, only the stage that was
killed. Each run has to end with the right program or with one clear error, never with a wrong or half-written folder, and the stack
has to plan once more at the end.

    cargo build --release --workspace
    python3 tests/benches/kill_soak.py [--kills 100] [--seed 1] [--domain 77]

The stack runs in processes of its own on the ROS domain. Every tenth run kills machine_interface while it runs the program, every
other tenth the command `patchmill plan` itself (the same folder is planned once more then). Prints a line a run and the counts;
exit code 1 when a run ended otherwise.
"""
import argparse
import hashlib
import json
import os
import pathlib
import random
import signal
import subprocess
import sys
import tempfile
import time

ROOT = pathlib.Path(__file__).resolve().parents[2]
FIXTURES = ROOT / "tests" / "fixtures"
PARAMETERS = ROOT / "launch_scripts" / "config" / "patchmill.yaml"
# For one run, the planner's patience with a lost stage included.
PATIENCE = 180.0
# Between a kill and the new process.
AWAY = 0.5
# The program runs so long, s.
EXECUTION = 5.0


class Stack:
    """The nodes, a process each."""

    def __init__(self, binaries, domain, logs):
        lines = (ROOT / "launch_scripts" / "config" / "nodes.txt").read_text().splitlines()
        self.names = [line for line in lines if line and not line.startswith("#")]
        self.binaries, self.logs = binaries, logs
        self.environment = {**os.environ, "ROS_DOMAIN_ID": str(domain)}
        self.processes = {}
        for name in self.names:
            self.start(name)

    def start(self, name):
        arguments = ["--ros-args", "-r", "__ns:=/patchmill", "--params-file", str(PARAMETERS)]
        with open(self.logs / f"{name}.log", "a") as log:
            # The machine may be killed between planning a program and running it.
            more = ["-p", "accepted_programs:=any"] if name == "machine_interface" else []
            # surface_ingestion opens what lies below its directory.
            self.processes[name] = subprocess.Popen(
                [str(self.binaries / name), *arguments, *more], cwd=FIXTURES, env=self.environment, stdout=log, stderr=log
            )

    def kill(self, name):
        self.processes[name].send_signal(signal.SIGKILL)
        self.processes[name].wait()

    def dead(self):
        return [name for name, process in self.processes.items() if process.poll() is not None]

    def end(self):
        for process in self.processes.values():
            process.terminate()
        for process in self.processes.values():
            try:
                process.wait(15)
            except subprocess.TimeoutExpired:
                process.kill()


def patchmill(binaries, *arguments):
    return subprocess.Popen(
        [str(binaries / "patchmill"), *arguments], cwd=FIXTURES, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )


def ended(process):
    """Exit code and what it said on stderr, or None when it did not end in time."""
    try:
        _, told = process.communicate(timeout=PATIENCE)
    except subprocess.TimeoutExpired:
        process.kill()
        process.communicate()
        return None, ""
    return process.returncode, told


def program_of(folder):
    """The folder's program by its hash; an error's text when the folder is not whole."""
    try:
        summary = json.loads((folder / "summary.json").read_text())
        found = hashlib.sha256((folder / "program.ngc").read_bytes()).hexdigest()
    except (OSError, ValueError) as e:
        return f"not whole: {e}"
    lacking = [name for name in ("machine.urdf", "bag/metadata.yaml", "job.yaml") if not (folder / name).exists()]
    if lacking:
        return f"lacks {', '.join(lacking)}"
    machine = hashlib.sha256((folder / "machine.urdf").read_bytes()).hexdigest()
    if machine != summary["machine_urdf_sha256"]:
        return "not the machine of its summary"
    return found if found == summary["program_sha256"] else "not the program of its summary"


def judged(code, told, folder, right):
    """right, error, or what is wrong."""
    if code is None:
        return f"WRONG: no end within {PATIENCE:.0f} s"
    left = sorted(path.name for path in folder.parent.iterdir())
    if code == 0:
        found = program_of(folder)
        return "right" if found == right else f"WRONG program: {found}"
    if left:
        return f"WRONG: failed and left {left}"
    return "error" if one_error(code, told) else f"WRONG: no clear error: {told[-300:]!r}"


def one_error(code, told):
    errors = [line for line in told.splitlines() if "error:" in line]
    return code is not None and len(errors) == 1


def executed(process, alive):
    """Done, an error, or what is wrong: when its machine was killed on the way, the program has to run from its beginning."""
    killed = time.monotonic()
    code, told = ended(process)
    if code == 0:
        return "WRONG: done too early" if alive and time.monotonic() - killed < EXECUTION else "done"
    return f"error ({told.strip().splitlines()[-1][:150]})" if one_error(code, told) else f"WRONG: code {code}, {told[-300:]!r}"


def command_killed(plan, folder, moment, right):
    """The command is killed: the folder is not there or whole, and the next plan into it leaves nothing else."""
    process = plan(folder)
    time.sleep(moment)
    process.kill()
    process.communicate()
    if folder.exists() and program_of(folder) != right:
        return f"WRONG program: {program_of(folder)}"
    code, told = ended(plan(folder))
    end = judged(code, told, folder, right)
    left = sorted(path.name for path in folder.parent.iterdir())
    return end if left == [folder.name] else f"WRONG: left {left}"


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kills", type=int, default=100)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--domain", type=int, default=77)
    parser.add_argument("--surface", default="small_bezier.json", help="one of tests/fixtures")
    parser.add_argument("--binaries", type=pathlib.Path, default=ROOT / "target" / "release")
    arguments = parser.parse_args()
    for name in ["patchmill", "planner"]:
        if not (arguments.binaries / name).exists():
            sys.exit(f"{arguments.binaries / name} is missing: cargo build --release --workspace")
    chance, counts = random.Random(arguments.seed), {}
    with tempfile.TemporaryDirectory() as scratch:
        scratch = pathlib.Path(scratch)
        stack = Stack(arguments.binaries, arguments.domain, scratch)
        plan = ["plan", arguments.surface, "--domain", str(arguments.domain), "--patches", "1..4", "--out"]

        def planning(folder):
            return patchmill(arguments.binaries, *plan, str(folder))

        def run(number, disturb):
            parent = scratch / f"run_{number}"
            parent.mkdir()
            process = planning(parent / "plan")
            disturb()
            return ended(process), parent / "plan"

        def kill(victim, moment):
            def disturb():
                time.sleep(moment)
                stack.kill(victim)
                time.sleep(AWAY)
                stack.start(victim)

            return disturb

        try:
            begun = time.monotonic()
            (code, told), first = run("first", lambda: None)
            if code != 0:
                sys.exit(f"the undisturbed plan failed: {told}")
            took, right = time.monotonic() - begun, program_of(first)
            print(f"undisturbed: {took:.1f} s, program {right[:12]}", flush=True)
            speed = json.loads((first / "summary.json").read_text())["machining_time_s"] / EXECUTION
            execution = ["execute", str(first), "--speed", f"{speed:.3f}", "--domain", str(arguments.domain)]
            for number in range(arguments.kills):
                if number % 10 == 9:
                    victim, moment, kind = "machine_interface", chance.uniform(0.0, EXECUTION), "an execution"
                    process = patchmill(arguments.binaries, *execution)
                    time.sleep(moment)
                    alive = process.poll() is None
                    kill(victim, 0.0)()
                    end = executed(process, alive)
                elif number % 10 == 4:
                    victim, moment, kind = "patchmill plan", chance.uniform(0.0, took), "its plan"
                    parent = scratch / f"run_{number}"
                    parent.mkdir()
                    end = command_killed(planning, parent / "plan", moment, right)
                else:
                    victim, moment, kind = chance.choice(stack.names), chance.uniform(0.0, took), "a plan"
                    (code, told), folder = run(number, kill(victim, moment))
                    end = judged(code, told, folder, right)
                    if end == "error":
                        end += f" ({told.strip().splitlines()[-1][:150]})"
                key = (kind, end.split(":")[0].split(" ")[0])
                counts[key] = counts.get(key, 0) + 1
                print(f"{number + 1}: {victim} killed {moment:.1f} s into {kind}: {end}", flush=True)
                if dead := stack.dead():
                    sys.exit(f"{', '.join(dead)} died by itself: {(scratch / f'{dead[0]}.log').read_text()[-2000:]}")
            (code, told), last = run("last", lambda: None)
            end = judged(code, told, last, right)
            print(f"undisturbed once more: {end}")
        finally:
            stack.end()
    print(", ".join(f"{kind} {end}: {count}" for (kind, end), count in sorted(counts.items())))
    if end != "right" or any(end == "WRONG" for _, end in counts):
        sys.exit(1)


if __name__ == "__main__":
    main()
