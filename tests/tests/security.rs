//! SROS2: who has no keys sees nothing and is not heard; executables without it refuse to run when it is asked for.
//!
//! `launch_scripts/test.sh` runs this file with the executables as everybody builds them, and at its end, by `test_security.sh`, with those of `--features security`.
#![allow(clippy::unwrap_used, reason = "a test's own helpers may fail like the test")]

use std::path::Path;
use std::process::{Command, Output, Stdio};
use std::time::{Duration, Instant};

use patchmill_tests::executables::executable;
use patchmill_tests::fixture;

/// For a plan of the smallest fixture, nodes that are waited for included.
const PATIENCE: Duration = Duration::from_secs(60);

type Environment = Vec<(&'static str, String)>;

fn plan(out: &Path, more: &[&str], environment: &Environment) -> Output {
    let mut command = Command::new(executable("patchmill"));
    command
        .args(["plan", "--strategy", "rolling-ball", "--patches", "1..2"])
        .arg(fixture("small_bezier.json"));
    command.arg("--out").arg(out).args(more).envs(environment.iter().cloned());
    let mut child =
        command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap();
    let end = Instant::now() + PATIENCE;
    while child.try_wait().unwrap().is_none() && Instant::now() < end {
        std::thread::sleep(Duration::from_millis(20));
    }
    // One that hangs counts as failed; one that has ended cannot be killed.
    let _ = child.kill();
    child.wait_with_output().unwrap()
}

/// A plan that must not succeed: one sentence on stderr, nothing in the folder.
fn refused(folder: &Path, more: &[&str], environment: &Environment) -> String {
    let out = folder.join("refused");
    let output = plan(&out, more, environment);
    let said = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(1), "{said}");
    assert!(
        !out.exists() || out.read_dir().unwrap().next().is_none(),
        "something was left in {}",
        out.display()
    );
    assert_eq!(said.trim_end().lines().count(), 1, "{said}");
    said
}

#[cfg(not(feature = "security"))]
#[test]
fn an_executable_without_sros2_refuses_to_run_unprotected_when_protection_is_asked_for() {
    let folder = tempfile::tempdir().unwrap();
    for strategy in ["Enforce", "Permissive"] {
        let environment =
            vec![("ROS_SECURITY_ENABLE", "true".to_owned()), ("ROS_SECURITY_STRATEGY", strategy.to_owned())];
        let said = refused(folder.path(), &[], &environment);
        assert!(said.contains("built without SROS2") && said.contains("--features security"), "{said}");
        let node = Command::new(executable("surface_ingestion")).envs(environment).output().unwrap();
        assert!(!node.status.success(), "a node ran");
    }
    let off = vec![("ROS_SECURITY_ENABLE", "false".to_owned())];
    let output = plan(&folder.path().join("plan"), &[], &off);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
}

#[cfg(feature = "security")]
mod protected {
    use std::io::{BufRead, BufReader, Read};
    use std::os::unix::fs::PermissionsExt;
    use std::process::{Child, ChildStdout};

    use patchmill_bag_recorder::BagReader;
    use patchmill_msgs::msg::{Job, MeshManifest};
    use patchmill_node_runtime::free_domain;
    use patchmill_tests::children::{Children, program_of, wait};
    use patchmill_tests::executables::ros_environment;
    use patchmill_tests::markdown::repository;
    use patchmill_tests::processes::Stack;
    use serde_json::Value;

    use super::*;

    /// Words that every plan puts on an unprotected wire: a topic, a type, and the surface's name out of a message.
    const WORDS: [&str; 3] = ["rt/patchmill/job", "patchmill_msgs::msg", "small_bezier.json"];

    fn keystore(arguments: &[&str]) {
        let script = repository().join("launch_scripts/keystore.sh");
        let output = Command::new("bash").arg(script).args(arguments).output().unwrap();
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    }

    fn enclave(keystore: &Path, name: &str) -> Environment {
        vec![
            ("ROS_SECURITY_ENABLE", "true".to_owned()),
            ("ROS_SECURITY_STRATEGY", "Enforce".to_owned()),
            ("ROS_SECURITY_KEYSTORE", keystore.display().to_string()),
            ("ROS_SECURITY_ENCLAVE_OVERRIDE", name.to_owned()),
        ]
    }

    fn unprotected() -> Environment {
        vec![("ROS_SECURITY_ENABLE", "false".to_owned())]
    }

    /// A script of `tests/peers` that says `ready`, goes on until it is told on stdin, and ends with a JSON document.
    struct Witness {
        child: Child,
        says: BufReader<ChildStdout>,
    }

    impl Witness {
        fn start(mut command: Command) -> Self {
            let mut child = command.stdin(Stdio::piped()).stdout(Stdio::piped()).spawn().unwrap();
            let mut says = BufReader::new(child.stdout.take().unwrap());
            let mut line = String::new();
            says.read_line(&mut line).unwrap();
            assert_eq!(line, "ready\n");
            Self { child, says }
        }

        /// The end of its stdin is the word.
        fn told(mut self) -> Value {
            drop(self.child.stdin.take());
            let mut text = String::new();
            self.says.read_to_string(&mut text).unwrap();
            assert!(wait(&mut self.child, 4 * PATIENCE).success(), "{text}");
            serde_json::from_str(&text).unwrap()
        }
    }

    fn wire(domain: u16) -> Witness {
        let mut command = Command::new("python3");
        command.arg(repository().join("tests/peers/wire.py")).arg(domain.to_string()).args(WORDS);
        Witness::start(command)
    }

    fn stranger(domain: u16, patience: Duration) -> Witness {
        let mut command = Command::new("bash");
        command.args(["-c", r#"source "$1" && exec python "$2" "$3""#, "bash"]).arg(ros_environment());
        command.arg(repository().join("tests/peers/stranger.py")).arg(patience.as_secs().to_string());
        command.env("ROS_DOMAIN_ID", domain.to_string());
        Witness::start(command)
    }

    /// What was seen of a stack that plans twice, first alone and then beside a stranger that then tries to be heard.
    struct Scene {
        wire: Value,
        stranger: Value,
        /// Ids of the jobs, and number of meshes, that a recorder of the stack heard.
        jobs: Vec<String>,
        meshes: usize,
        program: Vec<u8>,
    }

    /// The stack and its client in one environment, its recorder, a node named `viewer`, in another. The stranger waits for `patience` for
    /// each thing that he sees or that answers him.
    fn scene(own: &Environment, viewer: &Environment, patience: Duration) -> Scene {
        let folder = tempfile::tempdir().unwrap();
        let lease = free_domain().unwrap();
        let domain = lease.domain().to_string();
        let planned = |name: &str| {
            let out = folder.path().join(name);
            let output = plan(&out, &["--domain", &domain], own);
            assert!(output.status.success(), "{name}: {}", String::from_utf8_lossy(&output.stderr));
            program_of(&out)
        };
        let wire = wire(lease.domain());
        let _stack = Stack::start_in(lease.domain(), &[], own);
        let bag = folder.path().join("bag");
        let mut recorder = Children::default();
        let mut command = Command::new(executable("bag_recorder"));
        command
            .args(["--ros-args", "-r", "__node:=viewer", "-p"])
            .arg(format!("directory:={}", bag.display()));
        recorder.start(command.env("ROS_DOMAIN_ID", &domain).envs(viewer.iter().cloned()));
        let program = planned("alone");
        let wire = wire.told();
        let stranger = stranger(lease.domain(), patience);
        let watched = planned("watched");
        let stranger = stranger.told();
        assert!(watched == program, "the programs differ");
        recorder.terminate();
        assert!(recorder.wait(Duration::from_secs(30))[0].success());
        let bag = BagReader::open(&bag).unwrap();
        let jobs = bag.decoded::<Job>("/patchmill/job").unwrap().into_iter().map(|job| job.job_id).collect();
        let meshes = bag.decoded::<MeshManifest>("/patchmill/surface/mesh").unwrap().len();
        Scene { wire, stranger, jobs, meshes, program }
    }

    fn counts(object: &Value) -> Vec<u64> {
        object.as_object().unwrap().values().map(|count| count.as_u64().unwrap()).collect()
    }

    #[test]
    fn with_keys_a_stranger_neither_sees_nor_is_heard_and_without_he_does_both() {
        let folder = tempfile::tempdir().unwrap();
        let keys = folder.path().join("keys");
        let path = keys.to_string_lossy();
        keystore(&[&path, "/patchmill", "--listen", "/viewer"]);

        let open = scene(&unprotected(), &unprotected(), PATIENCE);
        assert!(counts(&open.wire["found"]).iter().all(|n| *n > 0), "{}", open.wire);
        assert!(counts(&open.stranger["messages"]).iter().all(|n| *n > 0), "{}", open.stranger);
        assert!(open.stranger["nodes"].as_array().unwrap().len() >= 8, "{}", open.stranger);
        assert_eq!(
            open.stranger["answered"],
            serde_json::json!({"job": true, "load_surface": true, "plan_surface": true})
        );
        assert!(open.jobs.iter().any(|id| id == "stranger"), "{:?}", open.jobs);

        let closed = scene(&enclave(&keys, "/patchmill"), &enclave(&keys, "/viewer"), Duration::from_secs(8));
        assert!(closed.wire["datagrams"].as_u64().unwrap() > 100, "{}", closed.wire);
        assert!(counts(&closed.wire["found"]).iter().all(|n| *n == 0), "{}", closed.wire);
        assert!(counts(&closed.stranger["messages"]).iter().all(|n| *n == 0), "{}", closed.stranger);
        assert_eq!(closed.stranger["ends"], 0, "{}", closed.stranger);
        assert_eq!(closed.stranger["nodes"], serde_json::json!([]));
        assert_eq!(
            closed.stranger["answered"],
            serde_json::json!({"job": false, "load_surface": false, "plan_surface": false})
        );
        // The listener heard the stack all the same.
        assert!(
            closed.jobs.len() >= 2 && !closed.jobs.iter().any(|id| id == "stranger"),
            "{:?}",
            closed.jobs
        );
        assert!(closed.meshes >= 1);
        assert!(closed.program == open.program, "the programs differ");
    }

    /// An enclave with a certificate of `keys` and rights that another authority has signed.
    fn self_made_rights(keys: &Path, others: &Path) -> Environment {
        keystore(&[&others.to_string_lossy(), "/guest"]);
        keystore(&[&keys.to_string_lossy(), "--listen", "/guest"]);
        for file in ["cert.pem", "key.pem", "identity_ca.cert.pem"] {
            let (from, to) =
                (keys.join("enclaves/guest").join(file), others.join("enclaves/guest").join(file));
            std::fs::remove_file(&to).unwrap();
            std::fs::copy(from, to).unwrap();
        }
        enclave(others, "/guest")
    }

    #[test]
    fn foreign_keys_self_made_rights_and_listeners_start_nothing() {
        let folder = tempfile::tempdir().unwrap();
        let [keys, foreign, mixed] = ["keys", "foreign", "mixed"].map(|name| folder.path().join(name));
        keystore(&[&keys.to_string_lossy()]);
        keystore(&[&foreign.to_string_lossy()]);
        let lease = free_domain().unwrap();
        let domain = lease.domain().to_string();
        let own = enclave(&keys, "/patchmill");
        let _stack = Stack::start_in(lease.domain(), &[], &own);
        let join = ["--domain", &domain];
        for outsider in [unprotected(), enclave(&foreign, "/patchmill"), self_made_rights(&keys, &mixed)] {
            let said = refused(folder.path(), &join, &outsider);
            assert!(said.contains("nobody serves"), "{outsider:?}: {said}");
        }
        // The library of the listener itself refuses; the other side is what self-made rights test.
        let said = refused(folder.path(), &join, &enclave(&keys, "/guest"));
        assert!(said.contains("cannot be made"), "{said}");
    }

    #[test]
    fn what_is_missing_or_wrong_in_a_keystore_is_one_clear_error() {
        let folder = tempfile::tempdir().unwrap();
        let keys = folder.path().join("keys");
        keystore(&[&keys.to_string_lossy(), "--days", "1"]);
        let enclaves = keys.join("enclaves/patchmill");
        let mode = |file: &Path| std::fs::metadata(file).unwrap().permissions().mode() & 0o777;
        for key in [enclaves.join("key.pem"), keys.join("private/ca.key.pem")] {
            assert_eq!(mode(&key), 0o600, "{}", key.display());
        }
        let said = refused(folder.path(), &[], &enclave(&keys, "/nobody"));
        assert!(said.contains("enclaves/nobody/identity_ca.cert.pem is missing: make it by"), "{said}");
        let said = refused(folder.path(), &[], &enclave(&keys, "/../keys"));
        assert!(said.contains("expected an absolute name"), "{said}");
        let signed = enclaves.join("permissions.p7s");
        let text = std::fs::read_to_string(&signed).unwrap();
        std::fs::write(&signed, text.replace("<topic>*</topic>", "<topic>x</topic>")).unwrap();
        let said = refused(folder.path(), &[], &enclave(&keys, "/patchmill"));
        assert!(said.contains("permissions"), "{said}");
        std::fs::write(&signed, text).unwrap();
        std::fs::write(enclaves.join("crl.pem"), "").unwrap();
        let said = refused(folder.path(), &[], &enclave(&keys, "/patchmill"));
        assert!(said.contains("crl.pem is there"), "{said}");
    }
}
