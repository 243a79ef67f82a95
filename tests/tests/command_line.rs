//! What the command line owes everybody: job files, JSON, silence where nobody looks, completions, manual pages, the doctor.
#![allow(clippy::unwrap_used, reason = "a test's own helpers may fail like the test")]

use std::fs;
use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Command, Output, Stdio};
use std::time::{Duration, Instant};

use patchmill_machine_interface::DEFAULT_MACHINE_URDF;
use patchmill_node_runtime::{free_domain, topics};
use patchmill_tests::children::{Children, program_of};
use patchmill_tests::executables::{executable, patchmill, ros_environment};
use patchmill_tests::fixture;
use patchmill_tests::golden::golden_bag;
use patchmill_tests::processes::Stack;
use serde_json::Value;

fn error_of(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

/// The one JSON document of a command.
fn document(output: &Output) -> Value {
    serde_json::from_slice(&output.stdout).unwrap_or_else(|e| panic!("{e}: {}", error_of(output)))
}

fn json_file(file: &Path) -> Value {
    serde_json::from_str(&fs::read_to_string(file).unwrap()).unwrap()
}

/// A plan with an option of every kind, into a folder.
fn plan_with_everything(surface: &Path, out: &Path, nodes: &Path) -> Output {
    let [surface, out, nodes] = [surface, out, nodes].map(|path| path.to_string_lossy());
    let tools = ["--tool", "r1=190,r2=10", "--tool", "r1=6.7,r2=6"];
    let numbers = ["--feed", "1800", "--scallop", "0.03", "--patches", "1..2", "--mount", "-40,-60,70,0,0,0"];
    let words = [
        "--pattern",
        "one-way",
        "--dialect",
        "siemens",
        "--strategy",
        "rolling-ball",
        "--select",
        "z=-900..900",
    ];
    let parameters = ["--params-file", &nodes, "-p", "surface_ingestion:samples_per_side:=25"];
    let all = [&["plan", &surface, "--out", &out, "--json"], &tools[..], &numbers, &words, &parameters];
    patchmill(&all.concat())
}

#[test]
fn a_plan_is_made_again_from_its_job_file() {
    let folder = tempfile::tempdir().unwrap();
    let place = |name: &str| folder.path().join(name);
    fs::copy(fixture("small_bezier.json"), place("s.json")).unwrap();
    fs::write(place("nodes.yaml"), "/**:\n  ros__parameters:\n    samples_per_side: 30\n    seed: 5\n")
        .unwrap();
    let first = plan_with_everything(&place("s.json"), &place("first"), &place("nodes.yaml"));
    assert!(first.status.success(), "{}", error_of(&first));
    // Nothing but the refused tool is told where nobody looks.
    assert_eq!(error_of(&first).lines().count(), 1, "{}", error_of(&first));
    assert!(error_of(&first).starts_with("tool ⌀400.00"), "{}", error_of(&first));
    let (mut told, summary) = (document(&first), json_file(&place("first/summary.json")));
    assert!(told["planned_s"].as_f64().unwrap() > 0.0 && told["folder"].as_str().unwrap().ends_with("first"));
    let keys = told.as_object_mut().unwrap();
    keys.remove("planned_s");
    keys.remove("folder");
    assert_eq!(told, summary);

    // The file stands alone: parameters are in it, and the folder may go elsewhere with its surface.
    fs::remove_file(place("nodes.yaml")).unwrap();
    fs::create_dir(place("moved")).unwrap();
    for name in ["s.json", "first"] {
        fs::rename(place(name), place("moved").join(name)).unwrap();
    }
    let job = place("moved/first/job.yaml").to_string_lossy().into_owned();
    let again = |name: &str, more: &[&str]| {
        let out = place(name).to_string_lossy().into_owned();
        let output = patchmill(&[&["plan", "--job", &job, "--out", &out], more].concat());
        assert!(output.status.success(), "{}", error_of(&output));
    };
    again("second", &[]);
    assert!(program_of(&place("moved/first")) == program_of(&place("second")), "the programs differ");
    let text = |file: &str| fs::read_to_string(place(file)).unwrap();
    assert_eq!(text("second/job.yaml"), text("moved/first/job.yaml").replace("../s.json", "../moved/s.json"));
    assert!(place("second/program.mpf").is_file());
    again("third", &["--feed", "900", "-p", "surface_ingestion:samples_per_side:=20"]);
    let summary = json_file(&place("third/summary.json"));
    assert_eq!(summary["feed_mm_per_min"], 900.0);
    assert_eq!((&summary["pattern"], &summary["scallop_height_mm"]), (&"one-way".into(), &0.03.into()));
    let samples = |patch: &Value| patch["sample_count"].as_u64().unwrap();
    assert_eq!(summary["patches"].as_array().unwrap().iter().map(samples).sum::<u64>(), 400);
}

#[test]
fn a_wrong_job_file_is_refused_before_anything_is_made() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("job.yaml");
    let out = folder.path().join("out").to_string_lossy().into_owned();
    fs::write(&file, "surface: s.json\nfeed_mm_per_min: fast\n").unwrap();
    let output = patchmill(&["plan", "--job", &file.to_string_lossy(), "--out", &out]);
    let said = error_of(&output);
    assert_eq!(output.status.code(), Some(2), "{said}");
    for word in ["job.yaml: line 2: feed_mm_per_min: `fast`", "finite number", "mm/min"] {
        assert!(said.contains(word), "{word}: {said}");
    }
    assert!(!Path::new(&out).exists());
}

#[test]
fn machines_get_one_document_of_every_command_and_of_its_failure() {
    let folder = tempfile::tempdir().unwrap();
    let surface = fixture("small_bezier.json").to_string_lossy().into_owned();
    let out = folder.path().join("compared");
    let to = out.to_string_lossy();
    let output =
        patchmill(&["compare", &surface, "--out", &to, "--patches", "1", "--stock", "r1=0,r2=5", "--json"]);
    assert_eq!(output.status.code(), Some(0), "{}", error_of(&output));
    assert!(error_of(&output).lines().all(|line| line.starts_with("tool ⌀")), "{}", error_of(&output));
    let (told, written) = (document(&output), json_file(&out.join("compare.json")));
    assert_eq!((&told["rows"], &told["lower_bound_s"]), (&written["rows"], &written["lower_bound_s"]));
    assert!(fs::read_to_string(out.join("job.yaml")).unwrap().contains("stock:\n- \"r1=0,r2=5\"\n"));

    let bag = folder.path().join("bag");
    fs::create_dir(&bag).unwrap();
    for entry in fs::read_dir(golden_bag()).unwrap() {
        let from = entry.unwrap().path();
        fs::copy(&from, bag.join(from.file_name().unwrap())).unwrap();
    }
    let told = document(&patchmill(&["bag", "repair", &bag.to_string_lossy(), "--json"]));
    assert!(
        told["messages"].as_u64().unwrap() > 10 && told["rewritten"].as_array().unwrap().is_empty(),
        "{told}"
    );

    let no = folder.path().join("no").to_string_lossy().into_owned();
    let wrong: [&[&str]; 4] = [
        &["plan", &no, "--out", &to, "--json"],
        &["compare", &no, "--out", &to, "--json"],
        &["replay", &no, "--from", "machine_interface", "--json"],
        &["bag", "repair", &no, "--json"],
    ];
    for arguments in wrong {
        let output = patchmill(arguments);
        assert!(!output.status.success());
        let text = document(&output)["error"].as_str().unwrap().to_owned();
        assert!(text.contains(&no) && text.contains("expected"), "{text}");
        assert_eq!(error_of(&output), format!("patchmill: error: {text}\n"));
    }
}

/// Runs `patchmill` for a moment: what waits for ever is ended, with exit code 124.
fn for_a_moment(arguments: &[&str]) -> Output {
    Command::new("timeout").arg("60").arg(executable("patchmill")).args(arguments).output().unwrap()
}

/// A command's one error, which names all words; its exit code.
fn refused(output: &Output, words: &[&str]) -> Option<i32> {
    let said = error_of(output);
    assert_eq!(said.lines().filter(|line| line.starts_with("patchmill: error:")).count(), 1, "{said}");
    assert!(words.iter().all(|word| said.contains(word)), "{words:?}: {said}");
    output.status.code()
}

#[test]
fn a_plan_whose_machine_was_changed_is_neither_written_nor_run() {
    let folder = tempfile::tempdir().unwrap();
    let plan = folder.path().join("plan").to_string_lossy().into_owned();
    let surface = fixture("small_bezier.json").to_string_lossy().into_owned();
    let planned = patchmill(&["plan", &surface, "--patches", "1", "--out", &plan]);
    assert!(planned.status.success(), "{}", error_of(&planned));
    let urdf = Path::new(&plan).join("machine.urdf");
    let proven = fs::read_to_string(&urdf).unwrap();
    // A tilting axis that turns the other way: another machine, and nothing else is wrong with it.
    let (others, tilting) = proven.split_once("<joint name=\"a\"").unwrap();
    let changed = tilting.replacen("<axis xyz=\"1 0 0\"/>", "<axis xyz=\"-1 0 0\"/>", 1);
    assert_ne!(changed, tilting);
    let summary = json_file(&Path::new(&plan).join("summary.json"));
    fs::write(&urdf, format!("{others}<joint name=\"a\"{changed}")).unwrap();
    let proven_sha256 = summary["machine_urdf_sha256"].as_str().unwrap();
    for command in [&["dialect", &plan, "--to", "siemens"][..], &["execute", &plan, "--speed", "1000"]] {
        let words = ["machine.urdf", "not the machine that was proven", proven_sha256];
        assert_eq!(refused(&for_a_moment(command), &words), Some(1));
    }
    assert!(!Path::new(&plan).join("program.mpf").exists());
    fs::write(&urdf, &proven).unwrap();
    assert!(patchmill(&["dialect", &plan, "--to", "siemens"]).status.success());
}

#[test]
fn a_result_that_is_lost_is_an_error() {
    let full = || fs::OpenOptions::new().write(true).open("/dev/full").unwrap();
    let commands: [&[&str]; 5] = [
        &["man", "plan"],
        &["completions", "fish"],
        &["--help"],
        &["--version"],
        &["bag", "repair", "/no/such", "--json"],
    ];
    for arguments in commands {
        let output = Command::new(executable("patchmill")).args(arguments).stdout(full()).output().unwrap();
        let words: &[&str] =
            if arguments[0] == "bag" { &["/no/such"] } else { &["standard output", "No space"] };
        assert_eq!(refused(&output, words), Some(1), "{arguments:?}");
    }
    // Whoever has read enough is not told.
    let mut command = Command::new("bash");
    command.args(["-c", "set -o pipefail; \"$0\" man plan | true"]).arg(executable("patchmill"));
    let output = command.output().unwrap();
    assert_eq!((output.status.code(), error_of(&output).as_str()), (Some(0), ""));
}

#[test]
fn fifos_and_endless_files_are_not_waited_for() {
    let folder = tempfile::tempdir().unwrap();
    let place = |name: &str| folder.path().join(name).to_string_lossy().into_owned();
    let surface = fixture("small_bezier.json").to_string_lossy().into_owned();
    let (fifo, plan, bag, out) = (place("fifo"), place("plan"), place("bag"), place("out"));
    fs::create_dir(&plan).unwrap();
    fs::create_dir(&bag).unwrap();
    for fifo in [&fifo, &format!("{bag}/bag_0.mcap")] {
        assert!(Command::new("mkfifo").arg(fifo).status().unwrap().success());
    }
    std::os::unix::fs::symlink("/dev/zero", format!("{plan}/summary.json")).unwrap();
    let commands: [&[&str]; 7] = [
        &["report", &plan],
        &["dialect", &plan, "--to", "fanuc"],
        &["plan", &surface, "--out", &out, "--rest-of", &plan],
        &["plan", &surface, "--out", &out, "--machine", &fifo],
        &["plan", &surface, "--out", &out, "--job", &fifo],
        &["bag", "repair", &bag],
        &["replay", &bag, "--from", "machine_interface"],
    ];
    for arguments in commands {
        let code = refused(&for_a_moment(arguments), &["not a regular file"]);
        assert!(matches!(code, Some(1 | 2)), "{arguments:?}: {code:?}");
    }
    assert!(!Path::new(&out).exists());
}

/// `script`, which every Debian has, is the terminal.
fn on_a_terminal(arguments: &[&str], no_color: bool) -> String {
    let line = [&[&*executable("patchmill").to_string_lossy()], arguments].concat().join(" ");
    let mut command = Command::new("script");
    command.args(["-qec", &line, "/dev/null"]).env("TERM", "xterm").env_remove("NO_COLOR");
    if no_color {
        command.env("NO_COLOR", "1");
    }
    let output = command.output().unwrap();
    String::from_utf8_lossy(&output.stdout).into_owned()
}

#[test]
fn bars_and_colours_are_for_terminals() {
    let folder = tempfile::tempdir().unwrap();
    let (surface, out) = (fixture("surface_3.json"), folder.path().join("out"));
    let (surface, out) = (surface.to_string_lossy(), out.to_string_lossy());
    let plan = ["plan", &surface, "--out", &out, "--patches", "1..2"];
    let shown = on_a_terminal(&plan, false);
    assert!(shown.contains("=>") && shown.contains("%/s, ") && shown.contains(" left"), "{shown}");
    let output = patchmill(&plan);
    assert_eq!((output.status.code(), error_of(&output).as_str()), (Some(0), ""));
    let output = patchmill(&[&plan[..], &["--verbose"]].concat());
    let said = error_of(&output);
    assert!(
        said.contains("path_generation: cutting") && said.contains("[info] [machine_interface]"),
        "{said}"
    );

    let red = "\u{1b}[31m";
    let wrong = ["plan", "no_such.json", "--out", &out];
    let bold_red = |text: &str| text.contains(red) || text.contains("\u{1b}[1m\u{1b}[31m");
    assert!(bold_red(&on_a_terminal(&wrong, false)), "{:?}", on_a_terminal(&wrong, false));
    assert!(!on_a_terminal(&wrong, true).contains('\u{1b}'), "{:?}", on_a_terminal(&wrong, true));
    assert!(!error_of(&patchmill(&wrong)).contains('\u{1b}'));
}

#[test]
fn bash_takes_the_completions_and_groff_the_manual() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("patchmill.bash");
    let script = patchmill(&["completions", "bash"]).stdout;
    fs::write(&file, &script).unwrap();
    let bash = Command::new("bash").arg("-n").arg(&file).output().unwrap();
    assert!(bash.status.success() && !script.is_empty(), "{}", error_of(&bash));
    // As a shell completes `patchmill plan --scal`.
    let asked = "source \"$0\"; COMP_WORDS=(patchmill plan --scal); COMP_CWORD=2; _patchmill patchmill --scal plan; echo \"${COMPREPLY[@]}\"";
    let bash = Command::new("bash").args(["-c", asked]).arg(&file).output().unwrap();
    assert_eq!(String::from_utf8_lossy(&bash.stdout).trim(), "--scallop", "{}", error_of(&bash));

    let pages = folder.path().join("man");
    assert!(patchmill(&["man", "--out", &pages.to_string_lossy()]).status.success());
    let written = fs::read_dir(&pages).unwrap().count();
    assert!(written >= 14, "{written} pages");
    for (name, words) in
        [("patchmill", "doctor"), ("patchmill-plan", "--gouge-tolerance"), ("patchmill-bag-repair", "--json")]
    {
        let page = pages.join(format!("{name}.1"));
        let groff = Command::new("groff")
            .args(["-man", "-Tutf8", "-Kutf8", "-ww", "-P-c", "-P-b", "-P-u"])
            .arg(&page)
            .output()
            .unwrap();
        assert!(groff.status.success() && groff.stderr.is_empty(), "{name}: {}", error_of(&groff));
        let text = String::from_utf8_lossy(&groff.stdout).replace('\u{2010}', "-");
        assert!(text.contains(words), "{name}: {text}");
    }
    let one = patchmill(&["man", "plan"]).stdout;
    assert_eq!(one, fs::read(pages.join("patchmill-plan.1")).unwrap());
}

/// The findings of the doctor: exit code, and state and text of every check.
fn doctor(more: &[&str]) -> (Option<i32>, Vec<[String; 3]>) {
    let output = patchmill(&[&["doctor", "--json"], more].concat());
    let told = document(&output);
    assert_eq!(told["well"].as_bool(), Some(output.status.success()), "{told}");
    let text = |finding: &Value, key: &str| finding[key].as_str().unwrap().to_owned();
    let findings = told["findings"].as_array().unwrap().iter();
    let findings = findings.map(|f| ["check", "state", "found"].map(|key| text(f, key))).collect();
    (output.status.code(), findings)
}

/// The doctor again and again, until checks say this of others that have just been started or killed, or a minute is over.
fn doctor_until(domain: &str, wanted: &[(&str, &str)]) -> (Option<i32>, Vec<[String; 3]>) {
    let end = Instant::now() + Duration::from_secs(60);
    loop {
        let told = doctor(&["--domain", domain, "--wait", "6"]);
        let says = |(check, words): &(&str, &str)| finding(&told.1, check).1.contains(words);
        if wanted.iter().all(says) || Instant::now() >= end {
            return told;
        }
    }
}

/// State and text of a check.
fn finding<'a>(findings: &'a [[String; 3]], check: &str) -> (&'a str, &'a str) {
    let [_, state, found] = findings.iter().find(|f| f[0] == check).unwrap_or_else(|| panic!("{findings:?}"));
    (state, found)
}

#[test]
fn the_doctor_sees_who_is_there() {
    let lease = free_domain().unwrap();
    let domain = lease.domain().to_string();
    let (code, alone) = doctor(&["--domain", &domain, "--wait", "1"]);
    assert_eq!(code, Some(0), "{alone:?}");
    for check in ["ROS domain", "loopback", "socket buffers", "disk", "machine"] {
        assert!(["ok", "warning"].contains(&finding(&alone, check).0), "{alone:?}");
    }
    assert_eq!(finding(&alone, "peers"), ("ok", &*format!("nobody else is on domain {domain}")));
    assert!(finding(&alone, "stack").1.starts_with("none on domain"), "{alone:?}");

    let mut stack = Stack::start(lease.domain(), &[]);
    let (code, beside) =
        doctor_until(&domain, &[("peers", "7 nodes in 7 participants: "), ("stack", "all stages")]);
    assert_eq!(code, Some(0), "{beside:?}");
    let (state, found) = finding(&beside, "peers");
    assert!(state == "ok" && found.starts_with("7 nodes in 7 participants: "), "{found}");
    assert!(
        topics::nodes::STAGES.iter().all(|stage| found.contains(&format!("/patchmill/{stage}"))),
        "{found}"
    );
    let (state, found) = finding(&beside, "stack");
    assert!(state == "ok" && found.contains("all stages") && found.contains("same interfaces"), "{found}");

    stack.kill(topics::nodes::PATH_GENERATION);
    let (code, lacking) = doctor_until(&domain, &[("stack", "path_generation not there")]);
    let (state, found) = finding(&lacking, "stack");
    assert!(code == Some(0) && state == "warning" && found.contains("path_generation not there"), "{found}");
}

/// A node of another implementation that publishes a type of ours.
const TALKER: &str = "
import rclpy
from patchmill_msgs.msg import Job
rclpy.init()
node = rclpy.create_node('talker')
node.create_publisher(Job, '/elsewhere/job', 1)
print('up', flush=True)
rclpy.spin(node)
";

#[test]
fn the_doctor_hears_the_type_hashes_of_rclpy() {
    let lease = free_domain().unwrap();
    let domain = lease.domain().to_string();
    let mut command = Command::new("bash");
    command.args(["-c", "source \"$1\" && exec python -c \"$2\"", "bash"]).arg(ros_environment()).arg(TALKER);
    let mut talker = Children::default();
    talker.start(command.env("ROS_DOMAIN_ID", &domain).stdout(Stdio::piped()));
    // Python takes its time; what counts is what is heard of a node that is there.
    let mut line = String::new();
    BufReader::new(talker.0[0].stdout.take().unwrap()).read_line(&mut line).unwrap();
    assert_eq!(line, "up\n");
    let (code, findings) =
        doctor_until(&domain, &[("peers", "/talker"), ("message types", "all defined as here")]);
    assert_eq!(code, Some(0), "{findings:?}");
    assert_eq!(finding(&findings, "peers"), ("ok", "1 nodes in 1 participants: /talker"));
    let (state, found) = finding(&findings, "message types");
    assert!(state == "ok" && found.contains("all defined as here"), "{found}");
}

#[test]
fn the_doctor_names_what_is_amiss_and_what_to_do() {
    let lease = free_domain().unwrap();
    let domain = lease.domain().to_string();
    let folder = tempfile::tempdir().unwrap();
    let urdf = folder.path().join("m.urdf");
    fs::write(&urdf, DEFAULT_MACHINE_URDF.replace("type=\"continuous\"", "type=\"fixed\"")).unwrap();
    let machine = ["--machine", &urdf.to_string_lossy()];
    // Nobody listens where a socket was and is no more.
    let port = std::net::TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
    let controller = ["--controller", &format!("linuxcnc://127.0.0.1:{port}")];
    let quick = ["--domain", &domain, "--wait", "0.5"];
    let (code, findings) = doctor(&[&machine[..], &controller, &quick].concat());
    assert_eq!(code, Some(1));
    let (state, found) = finding(&findings, "machine");
    assert!(state == "failed" && found.contains("m.urdf"), "{found}");
    let (state, found) = finding(&findings, "controller");
    assert!(state == "failed" && found.contains("refused"), "{found}");

    let output = patchmill(&[&["doctor"][..], &machine, &quick].concat());
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    assert_eq!(output.status.code(), Some(1));
    assert!(text.contains("failed  machine") && text.contains("→ expected links base_link"), "{text}");
    assert!(!text.contains('\u{1b}'), "{text}");
    let mut command = Command::new(executable("patchmill"));
    let output =
        command.args([&["doctor"], &quick[..]].concat()).env("ROS_DOMAIN_ID", "many").output().unwrap();
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(output.status.code() == Some(1) && text.contains("ROS_DOMAIN_ID is 'many'"), "{text}");
}

/// A file that was sent by somebody: neither its name nor what is in it does anything to the terminal or makes a line of its own.
#[test]
fn no_name_or_content_acts_on_the_terminal() {
    let folder = tempfile::tempdir().unwrap();
    let name = "\u{1b}[2J\u{1b}]0;x\u{7}\npatchmill: all is well\r\u{202e}.stl";
    let file = folder.path().join(name);
    let content = format!("solid a\n{}facet {name}\n\u{1b}[31mfacet\n", " ".repeat(2000));
    fs::write(&file, content).unwrap();
    let out = folder.path().join("out");
    let failed = patchmill(&["plan", &file.to_string_lossy(), "--out", &out.to_string_lossy(), "--verbose"]);
    let told = error_of(&failed);
    assert!(!failed.status.success() && told.contains(r"\u{1b}[2J"), "{told}");
    let acts = |c: char| (c.is_control() && c != '\n') || c == '\u{202e}';
    assert!(!told.contains(acts) && told.lines().all(|line| !line.starts_with("patchmill: all")), "{told:?}");
    assert!(!out.exists());
}
