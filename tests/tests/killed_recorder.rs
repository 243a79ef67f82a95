//! What a recorder leaves that is killed, runs out of disk or splits its bag: read back here and by other readers.
#![allow(clippy::unwrap_used, reason = "a test's own helpers may fail like the test")]

use std::fs;
use std::path::Path;
use std::process::{Command, Output, Stdio};
use std::time::{Duration, Instant};

use patchmill_bag_recorder::{BagMessage, BagOptions, BagReader, BagWriter, repair};
use patchmill_msgs::geometry_msgs::msg::Point;
use patchmill_msgs::msg::{Job, MeshChunk};
use patchmill_node_runtime::{ChunkPublisher, Node, NodeOptions, Qos, block_on, free_domain};
use patchmill_tests::altered_bag::topic_of;
use patchmill_tests::children::Children;
use patchmill_tests::executables::{executable, patchmill, peers_python};

const CHUNKS: &str = "/patchmill/surface/mesh/chunks";
const PATIENCE: Duration = Duration::from_secs(60);

/// A message of about 50 kB that does not compress, with its number.
fn chunk(index: u32) -> MeshChunk {
    let mut state = u64::from(index) + 1;
    let mut number = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 11) as f64
    };
    let vertices = (0..2000).map(|_| Point { x: number(), y: number(), z: number() }).collect();
    MeshChunk { surface_id: "s".to_owned(), index, count: 60_000, vertices, ..MeshChunk::default() }
}

/// Numbers of the chunks in a bag.
fn numbers(bag: &Path) -> Vec<u32> {
    let Ok(reader) = BagReader::open(bag) else { return Vec::new() };
    reader.decoded::<MeshChunk>(CHUNKS).unwrap().into_iter().map(|chunk| chunk.index).collect()
}

/// Messages that two other readers decode; both must agree, and with the metadata.
fn read_by_peers(bag: &Path) -> u64 {
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("peers/read_bag.py");
    let output = Command::new(peers_python()).arg(script).arg(bag).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let found: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    found.as_object().unwrap().values().map(|topic| topic["messages"].as_u64().unwrap()).sum()
}

fn repaired_by_command(bag: &Path) -> Output {
    patchmill(&["bag", "repair", &bag.to_string_lossy()])
}

fn recorder(domain: u16, directory: &Path, more: &[&str]) -> Command {
    let mut command = Command::new(executable("bag_recorder"));
    command.env("ROS_DOMAIN_ID", domain.to_string()).stderr(Stdio::null()).arg("--ros-args");
    command.arg("-p").arg(format!("directory:={}", directory.display()));
    for parameter in more {
        command.args(["-p", parameter]);
    }
    command
}

/// Sends chunks from `from` on until the bag has `wanted` messages and `more` have been sent after that: how many in all.
async fn send(publisher: &ChunkPublisher<MeshChunk>, bag: &Path, wanted: usize, more: u32) -> u32 {
    let end = Instant::now() + PATIENCE;
    let mut sent = 0;
    while numbers(bag).len() < wanted {
        assert!(Instant::now() < end, "the bag does not grow");
        sent += publisher.publish_paced((sent..sent + 20).map(chunk)).await as u32;
    }
    sent + publisher.publish_paced((sent..sent + more).map(chunk)).await as u32
}

#[test]
fn a_recorder_killed_at_any_moment_leaves_a_readable_bag() {
    let lease = free_domain().unwrap();
    let root = tempfile::tempdir().unwrap();
    // What is in the bag when the end begins, and what is sent until the kill: with several files, the kill hits one
    // of them at another place each time.
    for (round, (wanted, more)) in [(1, 0), (5, 1), (40, 7), (70, 23), (100, 61)].into_iter().enumerate() {
        let bag = root.path().join(format!("bag{round}"));
        let node_options = NodeOptions::local("sender", lease.domain());
        let (sent, at_least) = block_on(async {
            let node = Node::start(node_options).unwrap();
            let publisher = ChunkPublisher::<MeshChunk>::new(&node, "surface/mesh/chunks").unwrap();
            let mut command = recorder(lease.domain(), &bag, &["max_bag_size_mib:=1"]);
            let mut processes = Children(vec![command.spawn().unwrap()]);
            assert!(publisher.publisher().wait_for_subscriptions(1, PATIENCE).await);
            // There from the first moment, whatever happens next.
            assert!(bag.join("metadata.yaml").is_file());
            let sent = send(&publisher, &bag, wanted, more).await;
            let at_least = numbers(&bag).len();
            processes.0[0].kill().unwrap();
            processes.0[0].wait().unwrap();
            node.shutdown().await;
            (sent, at_least)
        })
        .unwrap();

        // Our reader takes it as it is: all from the first on, without a hole.
        let read = numbers(&bag);
        assert!(read.len() >= at_least && at_least >= wanted && read.len() <= sent as usize);
        assert!(read.iter().copied().eq(0..read.len() as u32), "{read:?}");
        let output = repaired_by_command(&bag);
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        assert_eq!(numbers(&bag), read);
        assert_eq!(read_by_peers(&bag), read.len() as u64);
        assert!(repair(&bag).unwrap().rewritten.is_empty());
    }
}

/// A bag of three topics that was not ended: directory, and its messages.
fn unfinished(root: &Path) -> (std::path::PathBuf, Vec<BagMessage>) {
    let bag = root.join("bag");
    let mut writer = BagWriter::create(&bag).unwrap();
    let topics = ["/a", "/b", "/c"].map(|name| topic_of::<Job>(name, Qos::Status));
    for n in 0..60 {
        let job = Job { job_id: n.to_string(), ..Job::default() };
        writer.write(&topics[n % 3], 1000 + n as u64, &job).unwrap();
        if n % 7 == 6 {
            writer.flush().unwrap();
        }
    }
    writer.flush().unwrap();
    // Copied while it is open: the file as a kill would leave it.
    let left = root.join("left");
    fs::create_dir(&left).unwrap();
    for name in ["bag_0.mcap", "metadata.yaml"] {
        fs::copy(bag.join(name), left.join(name)).unwrap();
    }
    writer.finish().unwrap();
    (left, BagReader::open(&bag).unwrap().messages().unwrap())
}

#[test]
fn a_file_cut_anywhere_gives_its_whole_chunks() {
    let root = tempfile::tempdir().unwrap();
    let (left, messages) = unfinished(root.path());
    assert_eq!(messages.len(), 60);
    let file = left.join("bag_0.mcap");
    let whole = fs::read(&file).unwrap();
    assert_eq!(BagReader::open(&left).unwrap().messages().unwrap(), messages);
    let mut before = 0;
    for cut in (0..whole.len()).step_by(53).chain([whole.len() - 1]) {
        fs::write(&file, &whole[..cut]).unwrap();
        let (read, ends) = BagReader::open(&left).unwrap().read(|_| true).unwrap();
        assert_eq!(read, messages[..read.len()], "{cut}");
        assert!(read.len() >= before && ends.len() == 1, "{cut}");
        before = read.len();
        let repaired = repair(&left).unwrap();
        assert_eq!((repaired.rewritten.len(), repaired.summary.message_count), (1, read.len() as u64));
        let (again, ends) = BagReader::open(&left).unwrap().read(|_| true).unwrap();
        assert!(again == read && ends.is_empty(), "{cut}");
    }
    assert!(before >= 56, "{before}");
    assert_eq!(read_by_peers(&left), before as u64);
    // Nothing at all was written.
    fs::write(&file, b"").unwrap();
    fs::remove_file(left.join("metadata.yaml")).unwrap();
    assert_eq!(repair(&left).unwrap().summary.message_count, 0);
    assert_eq!(read_by_peers(&left), 0);
}

#[test]
fn damage_is_told_from_an_end_that_is_missing() {
    let root = tempfile::tempdir().unwrap();
    unfinished(root.path());
    let file = root.path().join("bag/bag_0.mcap");
    let whole = fs::read(&file).unwrap();
    // In the head of the file, and in a compressed chunk.
    let chunk = whole.windows(4).position(|bytes| bytes == [0x28, 0xb5, 0x2f, 0xfd]).unwrap();
    for place in [20, chunk + 40] {
        let mut bytes = whole.clone();
        bytes[place] ^= 0x55;
        fs::write(&file, bytes).unwrap();
        let read = BagReader::open(&root.path().join("bag")).unwrap().messages().map(|read| read.len());
        let text = read.unwrap_err().text;
        assert!(text.contains("bag_0.mcap") && text.contains("damaged"), "{text}");
    }
    fs::write(&file, "this is no bag").unwrap();
    assert!(BagReader::open(&root.path().join("bag")).unwrap().messages().is_err());
    assert!(!repaired_by_command(&root.path().join("bag")).status.success());
}

#[test]
fn a_bag_splits_by_size_and_reads_in_the_order_of_its_files() {
    let root = tempfile::tempdir().unwrap();
    let bag = root.path().join("split");
    let limit = 200_000;
    let mut writer = BagWriter::create_with(&bag, BagOptions { max_file_bytes: limit }).unwrap();
    let (chunks, jobs) =
        (topic_of::<MeshChunk>(CHUNKS, Qos::Chunks), topic_of::<Job>("/patchmill/job", Qos::Status));
    for n in 0..60 {
        writer.write(&chunks, 1000 + u64::from(n), &chunk(n)).unwrap();
        writer.write(&jobs, 1000 + u64::from(n), &Job::default()).unwrap();
    }
    let summary = writer.finish().unwrap();
    assert!(summary.files.len() >= 12, "{}", summary.files.len());
    for (number, file) in summary.files.iter().enumerate() {
        assert_eq!(file.name, format!("split_{number}.mcap"));
        // The data keep the limit; the summary with its definitions comes on top.
        assert!(fs::metadata(bag.join(&file.name)).unwrap().len() < limit + 40_000);
    }
    assert_eq!(summary.files.iter().map(|f| f.message_count).sum::<u64>(), 120);
    assert!(numbers(&bag).into_iter().eq(0..60));
    let times: Vec<u64> = BagReader::open(&bag).unwrap().messages().unwrap().iter().map(|m| m.time).collect();
    assert!(times.is_sorted());
    assert_eq!(read_by_peers(&bag), 120);
}

#[test]
fn a_bag_that_is_being_recorded_is_not_repaired() {
    let root = tempfile::tempdir().unwrap();
    let bag = root.path().join("bag");
    let writer = BagWriter::create(&bag).unwrap();
    assert!(repair(&bag).unwrap_err().text.contains("is being recorded"));
    writer.finish().unwrap();
    assert!(repair(&bag).unwrap().rewritten.is_empty());
}

#[test]
fn a_disk_that_takes_no_more_ends_the_recorder_with_an_error() {
    let lease = free_domain().unwrap();
    let root = tempfile::tempdir().unwrap();
    let bag = root.path().join("bag");
    // A limit on the size of files stands for the full disk: 2 MiB.
    let script = "trap '' XFSZ; ulimit -f 4096; exec \"$0\" \"$@\"";
    let recorder = recorder(lease.domain(), &bag, &[]);
    let mut command = Command::new("sh");
    command.args(["-c", script]).arg(recorder.get_program()).args(recorder.get_args());
    command.env("ROS_DOMAIN_ID", lease.domain().to_string()).stderr(Stdio::piped());
    let output = block_on(async {
        let node = Node::start(NodeOptions::local("sender", lease.domain())).unwrap();
        let publisher = ChunkPublisher::<MeshChunk>::new(&node, "surface/mesh/chunks").unwrap();
        let mut processes = Children(vec![command.spawn().unwrap()]);
        assert!(publisher.publisher().wait_for_subscriptions(1, PATIENCE).await);
        let end = Instant::now() + PATIENCE;
        let mut sent = 0;
        while processes.0[0].try_wait().unwrap().is_none() {
            assert!(Instant::now() < end, "the recorder goes on");
            sent += publisher.publish_paced((sent..sent + 20).map(chunk)).await as u32;
        }
        node.shutdown().await;
        processes.0.remove(0).wait_with_output().unwrap()
    })
    .unwrap();
    let said = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{said}");
    assert!(said.contains("bag_0.mcap") && said.contains("File too large"), "{said}");
    // What was written before is there.
    assert!(numbers(&bag).len() > 10);
}

#[test]
fn a_directory_that_cannot_be_written_is_refused_at_once() {
    let lease = free_domain().unwrap();
    let root = tempfile::tempdir().unwrap();
    let file = root.path().join("file");
    fs::write(&file, "").unwrap();
    for directory in [file.join("bag"), root.path().to_path_buf()] {
        let output = recorder(lease.domain(), &directory, &[]).stderr(Stdio::piped()).output().unwrap();
        let said = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(1), "{said}");
        assert!(said.contains(&directory.display().to_string()), "{said}");
    }
}
