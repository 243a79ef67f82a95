#!/usr/bin/env python3
"""Load on the stack: what it does when there is much of everything, and what it keeps afterwards.

    cargo build --release --workspace && cargo build --release -p patchmill_tests --example load_client
    python3 tests/benches/load_soak.py [--plans 500] [--calls 10000] [--stacks 8] [--domain 78] [--only stacks,calls,deaf,plans]

stacks: so many stacks in namespaces of one domain, a process a node, plan at once; each gives the program that it gives alone.
calls:  service calls to `patchmill up`, each sent once and answered.
deaf:   plans beside a recorder that is stopped (SIGSTOP) and a subscriber of every topic that never takes.
plans:  plans one after the other in one `patchmill up`: memory (RSS), file descriptors and threads stay.
Prints tables; exit code 1 when a bound is broken.
"""
import argparse
import hashlib
import os
import pathlib
import signal
import subprocess
import sys
import tempfile
import time

ROOT = pathlib.Path(__file__).resolve().parents[2]
FIXTURES = ROOT / "tests" / "fixtures"
SURFACES = ["small_bezier.json", "steep_bezier.json", "valley.json"]
# One plan of many stacks at once, and every other step.
PATIENCE = 900.0
# Of all plans, those at the beginning in which memory may still grow: caches and the allocator's arenas fill.
WARM_UP = 0.2
# Largest change of memory from the end of the warm-up to the end, by the fitted line; the same of descriptors and threads.
FLAT = 0.05


class Failure(Exception):
    pass


def started(command, domain, log, **more):
    environment = {**os.environ, "ROS_DOMAIN_ID": str(domain)}
    return subprocess.Popen(command, cwd=FIXTURES, env=environment, stderr=log, **more)


def end(processes):
    for process in processes:
        process.send_signal(signal.SIGCONT)
        process.terminate()
    for process in processes:
        try:
            process.wait(20)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


def usage(pid):
    """MiB of memory, file descriptors, threads of a process."""
    status = pathlib.Path(f"/proc/{pid}/status").read_text()
    field = lambda name: int(status.split(f"{name}:")[1].split()[0])
    return field("VmRSS") / 1024, len(os.listdir(f"/proc/{pid}/fd")), field("Threads")



class Up:
    """`patchmill up` and what runs beside it."""

    def __init__(self, arguments, log):
        self.arguments, self.log = arguments, log
        self.up = started([str(arguments.binaries / "patchmill"), "up", "--surfaces", "."], arguments.domain, log)
        self.beside = []

    def client(self, *words, **more):
        command = [str(self.arguments.binaries / "examples" / "load_client"), *words]
        process = started(command, self.arguments.domain, self.log, stdout=subprocess.PIPE, text=True, **more)
        self.beside.append(process)
        return process

    def lines(self, *words):
        process = self.client(*words)
        for line in process.stdout:
            yield line.split()
        if process.wait() != 0 or self.up.poll() is not None:
            raise Failure(f"load_client {' '.join(words)}: {tail(self.log)}")

    def plans(self, count, surfaces):
        """A plan's line, and what the process uses after it."""
        for number, surface, patches, seconds, program in self.lines("plans", str(count), *surfaces):
            yield int(number), (surface, patches), float(seconds), program, usage(self.up.pid)

    def end(self):
        end([self.up, *self.beside])


def tail(log):
    log.flush()
    return pathlib.Path(log.name).read_text()[-1500:]


def stacks(arguments, scratch):
    """Every stack plans its surface at once with the others; the programs are those of plans made alone."""
    print(f"\n{arguments.stacks} stacks in one domain at once", flush=True)
    patchmill = [str(arguments.binaries / "patchmill"), "plan"]
    jobs = [["--patches", f"1..{2 + place // len(SURFACES)}"] for place in range(arguments.stacks)]
    surfaces = [SURFACES[place % len(SURFACES)] for place in range(arguments.stacks)]
    program = lambda folder: hashlib.sha256((folder / "program.ngc").read_bytes()).hexdigest()
    alone = []
    with open(scratch / "stacks.log", "w") as log:
        for place, (surface, job) in enumerate(zip(surfaces, jobs)):
            out = scratch / f"alone_{place}"
            if started([*patchmill, surface, *job, "--out", str(out)], 0, log, stdout=log).wait(PATIENCE) != 0:
                raise Failure(f"{surface} alone: {tail(log)}")
            alone.append(program(out))
        nodes = (ROOT / "launch_scripts" / "config" / "nodes.txt").read_text().splitlines()
        nodes = [line for line in nodes if line and not line.startswith("#")]
        processes, plans = [], []
        try:
            for place in range(arguments.stacks):
                for node in nodes:
                    command = [str(arguments.binaries / node), "--ros-args", "-r", f"__ns:=/cell_{place}"]
                    processes.append(started(command, arguments.domain, log))
            begun = time.monotonic()
            for place, (surface, job) in enumerate(zip(surfaces, jobs)):
                where = ["--domain", str(arguments.domain), "--namespace", f"/cell_{place}"]
                command = [*patchmill, surface, *job, *where, "--out", str(scratch / f"together_{place}")]
                plans.append(started(command, arguments.domain, log, stdout=log))
            bad = []
            for place, plan in enumerate(plans):
                code = plan.wait(max(1.0, PATIENCE - (time.monotonic() - begun)))
                took = time.monotonic() - begun
                same = code == 0 and program(scratch / f"together_{place}") == alone[place]
                print(f"  /cell_{place}: {surfaces[place]} {' '.join(jobs[place])}: {'right' if same else 'WRONG'}, {took:.0f} s", flush=True)
                if not same:
                    bad.append(f"/cell_{place} (exit code {code})")
            dead = [process.args[0] for process in processes if process.poll() is not None]
            if bad or dead:
                raise Failure(f"stacks at once: wrong: {bad}, ended by themselves: {dead}: {tail(log)}")
            print(f"  all right after {time.monotonic() - begun:.0f} s, {len(processes)} processes", flush=True)
        finally:
            end([*processes, *plans])


def calls(arguments, scratch):
    print(f"\n{arguments.calls} service calls", flush=True)
    with open(scratch / "calls.log", "w") as log:
        up = Up(arguments, log)
        try:
            # The first round fills what is allocated once.
            for _ in up.lines("calls", str(max(20, arguments.calls // 10)), SURFACES[0]):
                pass
            before = usage(up.up.pid)
            print("  service                                   calls   per s  slowest ms  median ms", flush=True)
            for name, count, rate, slowest, median in up.lines("calls", str(arguments.calls), SURFACES[0]):
                print(f"  {name:40} {count:>6} {rate:>7} {slowest:>11} {median:>10}", flush=True)
            time.sleep(1)
            compare("calls", before, usage(up.up.pid))
        finally:
            up.end()


def deaf(arguments, scratch):
    count = max(6, arguments.plans // 25)
    print(f"\n{count} plans each: alone, beside a stopped recorder, beside a subscriber that never takes", flush=True)
    with open(scratch / "deaf.log", "w") as log:
        up = Up(arguments, log)
        try:
            programs, seconds = {}, {}

            def round_of(name):
                took, last = [], None
                for _, key, spent, program, last in up.plans(count, SURFACES[:1]):
                    took.append(spent)
                    if programs.setdefault(key, program) != program:
                        raise Failure(f"{name}: another program of {key}")
                seconds[name] = sum(took) / len(took)
                print(f"  {name}: mean {seconds[name]:.2f} s, longest {max(took):.2f} s, {told(last)}", flush=True)

            round_of("alone")
            command = [str(arguments.binaries / "bag_recorder"), "--ros-args", "-p", f"directory:={scratch / 'stopped'}"]
            recorder = started(command, arguments.domain, log)
            up.beside.append(recorder)
            time.sleep(3)
            recorder.send_signal(signal.SIGSTOP)
            round_of("beside a stopped recorder")
            recorder.send_signal(signal.SIGCONT)
            never = up.client("deaf", stdin=subprocess.PIPE)
            if never.stdout.readline().strip() != "deaf":
                raise Failure(f"no deaf subscriber: {tail(log)}")
            time.sleep(3)
            round_of("beside a subscriber that never takes")
            never.kill()
            round_of("after both")
        finally:
            up.end()


def plans(arguments, scratch):
    print(f"\n{arguments.plans} plans in one process", flush=True)
    with open(scratch / "plans.log", "w") as log:
        up = Up(arguments, log)
        try:
            samples, programs, step = [], {}, max(1, arguments.plans // 20)
            begun = time.monotonic()
            print("  plan  seconds      MiB  descriptors  threads", flush=True)
            for number, key, seconds, program, now in up.plans(arguments.plans, SURFACES):
                if programs.setdefault(key, program) != program:
                    raise Failure(f"plan {number}: another program of {key}")
                samples.append(now)
                if number % step == 0 or number + 1 == arguments.plans:
                    print(f"  {number:>4} {seconds:>8.2f} {now[0]:>8.1f} {now[1]:>12} {now[2]:>8}", flush=True)
            print(f"  {len(samples)} plans of {len(programs)} jobs in {time.monotonic() - begun:.0f} s, every job's program the same each time")
            flat(samples)
        finally:
            up.end()


def flat(samples):
    """Fits a line to the samples after the warm-up."""
    settled = samples[int(len(samples) * WARM_UP) :]
    bad = []
    for what, values in zip(["memory", "descriptors", "threads"], zip(*settled)):
        mean_x, mean_y = (len(values) - 1) / 2, sum(values) / len(values)
        spread = sum((x - mean_x) ** 2 for x in range(len(values)))
        slope = sum((x - mean_x) * (y - mean_y) for x, y in enumerate(values)) / max(spread, 1)
        change = slope * (len(values) - 1) / mean_y
        print(f"  {what}: {change:+.1%} by the fitted line over the last {len(values)} plans (mean {mean_y:.1f})")
        if abs(change) > FLAT:
            bad.append(f"{what} {change:+.1%}")
    if bad:
        raise Failure(f"not flat (±{FLAT:.0%}): {', '.join(bad)}")


def told(now):
    return f"{now[0]:.1f} MiB, {now[1]} descriptors, {now[2]} threads"


def compare(what, before, after):
    print(f"  before: {told(before)}; after: {told(after)}", flush=True)
    for name, one, other in zip(["memory", "descriptors", "threads"], before, after):
        if other > one * (1 + FLAT):
            raise Failure(f"{what}: {name} grew from {one:.1f} to {other:.1f}")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--plans", type=int, default=500)
    parser.add_argument("--calls", type=int, default=10_000)
    parser.add_argument("--stacks", type=int, default=8)
    parser.add_argument("--domain", type=int, default=78)
    parser.add_argument("--only", default="stacks,calls,deaf,plans")
    parser.add_argument("--binaries", type=pathlib.Path, default=ROOT / "target" / "release")
    arguments = parser.parse_args()
    for name in ["patchmill", "planner", "bag_recorder", "examples/load_client"]:
        if not (arguments.binaries / name).exists():
            sys.exit(f"{arguments.binaries / name} is missing: see --help")
    parts, failures = {"stacks": stacks, "calls": calls, "deaf": deaf, "plans": plans}, []
    with tempfile.TemporaryDirectory() as scratch:
        for name in arguments.only.split(","):
            try:
                parts[name](arguments, pathlib.Path(scratch))
            except (Failure, subprocess.TimeoutExpired) as e:
                print(f"  FAILED: {e}", flush=True)
                failures.append(name)
    print(f"\n{'failed: ' + ', '.join(failures) if failures else 'all bounds kept'}")
    sys.exit(1 if failures else 0)


if __name__ == "__main__":
    main()
