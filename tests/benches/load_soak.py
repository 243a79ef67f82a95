#!/usr/bin/env python3
"""Load on the stack: what it does when there is much of everything, and what it keeps afterwards.

    cargo build --release --workspace && cargo build --release -p patchmill_tests --example load_client
    python3 tests/benches/load_soak.py [--plans 500] [--calls 10000] [--stacks 8] [--domain 78] [--flat 0.05] [--only idle,stacks,calls,deaf,plans]

idle:   one stack, then three in one domain, a process a node, with nothing to do: processor time.
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
SURFACES = ["small_bezier.json", "nurbs_trough.json"]
LARGER = "surface_3.json"
# What the nodes of a stack may take while nothing is planned, of one core; watched for so long (s) once discovery has settled (s).
IDLE = 0.05
IDLE_WATCHED = 20.0
SETTLED = 15.0
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



def processor(processes):
    """Processor time of processes so far, s."""
    ticks = 0
    for process in processes:
        fields = pathlib.Path(f"/proc/{process.pid}/stat").read_text().rsplit(")", 1)[1].split()
        ticks += int(fields[11]) + int(fields[12])
    return ticks / os.sysconf("SC_CLK_TCK")


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


def stack(arguments, place, log):
    """The processes of a stack of its own namespace."""
    nodes = (ROOT / "launch_scripts" / "config" / "nodes.txt").read_text().splitlines()
    names = ["--ros-args", "-r", f"__ns:=/cell_{place}"]
    nodes = [line for line in nodes if line and not line.startswith("#")]
    return [started([str(arguments.binaries / node), *names], arguments.domain, log) for node in nodes]


def idling(processes, count):
    """What so many stacks take while nothing is planned, of one core; told, and whether it is too much."""
    before = processor(processes)
    time.sleep(IDLE_WATCHED)
    spent = processor(processes) - before
    print(f"  {count} stacks idle: {spent:.2f} s of processor in {IDLE_WATCHED:.0f} s, {spent / IDLE_WATCHED:.3f} of a core", flush=True)
    return spent > IDLE * count * IDLE_WATCHED


def idle(arguments, scratch):
    print("\nstacks with nothing to do", flush=True)
    with open(scratch / "idle.log", "w") as log:
        for count in [1, 3]:
            processes = []
            try:
                for place in range(count):
                    processes += stack(arguments, place, log)
                time.sleep(SETTLED)
                print(f"  {count} stacks begun: {processor(processes):.2f} s of processor", flush=True)
                if idling(processes, count):
                    raise Failure(f"{count} stacks are not idle: more than {IDLE} of a core each")
            finally:
                end(processes)


def stacks(arguments, scratch):
    """Every stack plans alone, then all at once: the programs are the same."""
    print(f"\n{arguments.stacks} stacks in one domain", flush=True)
    cells = [
        (place, [*SURFACES, LARGER][place % 3], f"1..{2 + place // 3}") for place in range(arguments.stacks)
    ]
    processes, alone, together = [], [], []

    def plan(place, surface, patches, folder):
        where = ["--domain", str(arguments.domain), "--namespace", f"/cell_{place}", "--out", str(scratch / f"{folder}_{place}")]
        command = [str(arguments.binaries / "patchmill"), "plan", surface, "--patches", patches, *where]
        with open(scratch / f"{folder}_{place}.log", "w") as log:
            return started(command, arguments.domain, log, stdout=log)

    def program(process, place, folder):
        """The program's hash, or the error."""
        if process.wait(PATIENCE) != 0:
            return (scratch / f"{folder}_{place}.log").read_text().strip().splitlines()[-1]
        return hashlib.sha256((scratch / f"{folder}_{place}" / "program.ngc").read_bytes()).hexdigest()

    try:
        with open(scratch / "stacks.log", "w") as log:
            for place, _, _ in cells:
                processes += stack(arguments, place, log)
        begun = time.monotonic()
        for place, surface, patches in cells:
            alone.append(program(plan(place, surface, patches, "alone"), place, "alone"))
        print(f"  {len(processes)} processes; one after the other: {time.monotonic() - begun:.0f} s", flush=True)
        busy = idling(processes, arguments.stacks)
        begun = time.monotonic()
        for place, surface, patches in cells:
            together.append(plan(place, surface, patches, "together"))
        bad = []
        for (place, surface, patches), process, right in zip(cells, together, alone):
            found = program(process, place, "together")
            same = found == right and len(found) == 64
            took = time.monotonic() - begun
            print(f"  /cell_{place}: {surface} --patches {patches}: {'right' if same else f'WRONG: {found}, alone {right}'}, {took:.0f} s", flush=True)
            bad += [] if same else [f"/cell_{place}"]
        dead = [process.args[0] for process in processes if process.poll() is not None]
        if bad or dead or busy:
            raise Failure(f"stacks at once: wrong: {bad}, ended by themselves: {dead}, {'not ' if busy else ''}idle")
    finally:
        end([*processes, *together])


def calls(arguments, scratch):
    print(f"\n{arguments.calls} service calls, after as many", flush=True)
    with open(scratch / "calls.log", "w") as log:
        up = Up(arguments, log)
        try:
            # The first round fills what is allocated once: a reader keeps its newest 64 messages, a writer what it sent in the last
            # seconds, the allocator its arenas.
            for _ in up.lines("calls", str(arguments.calls), SURFACES[0]):
                pass
            before = usage(up.up.pid)
            print("  service                                   calls   per s  slowest ms  median ms", flush=True)
            for name, count, rate, slowest, median in up.lines("calls", str(arguments.calls), SURFACES[0]):
                print(f"  {name:40} {count:>6} {rate:>7} {slowest:>11} {median:>10}", flush=True)
            time.sleep(1)
            compare("calls", before, usage(up.up.pid), arguments.flat)
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
            flat(samples, arguments.flat)
        finally:
            up.end()


def flat(samples, bound):
    """Fits a line to the samples after the warm-up."""
    settled = samples[int(len(samples) * WARM_UP) :]
    bad = []
    for what, values in zip(["memory", "descriptors", "threads"], zip(*settled)):
        mean_x, mean_y = (len(values) - 1) / 2, sum(values) / len(values)
        spread = sum((x - mean_x) ** 2 for x in range(len(values)))
        slope = sum((x - mean_x) * (y - mean_y) for x, y in enumerate(values)) / max(spread, 1)
        change = slope * (len(values) - 1) / mean_y
        print(f"  {what}: {change:+.1%} by the fitted line over the last {len(values)} plans (mean {mean_y:.1f})")
        if abs(change) > bound:
            bad.append(f"{what} {change:+.1%}")
    if bad:
        raise Failure(f"not flat (±{bound:.0%}): {', '.join(bad)}")


def told(now):
    return f"{now[0]:.1f} MiB, {now[1]} descriptors, {now[2]} threads"


def compare(what, before, after, bound):
    print(f"  before: {told(before)}; after: {told(after)}", flush=True)
    for name, one, other in zip(["memory", "descriptors", "threads"], before, after):
        if other > one * (1 + bound):
            raise Failure(f"{what}: {name} grew from {one:.1f} to {other:.1f}")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--plans", type=int, default=500)
    parser.add_argument("--calls", type=int, default=10_000)
    parser.add_argument("--flat", type=float, default=FLAT, help="largest change of memory, descriptors and threads, as a share")
    parser.add_argument("--stacks", type=int, default=8)
    parser.add_argument("--domain", type=int, default=78)
    parser.add_argument("--only", default="idle,stacks,calls,deaf,plans")
    parser.add_argument("--binaries", type=pathlib.Path, default=ROOT / "target" / "release")
    arguments = parser.parse_args()
    for name in ["patchmill", "planner", "bag_recorder", "examples/load_client"]:
        if not (arguments.binaries / name).exists():
            sys.exit(f"{arguments.binaries / name} is missing: see --help")
    parts, failures = {"idle": idle, "stacks": stacks, "calls": calls, "deaf": deaf, "plans": plans}, []
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
