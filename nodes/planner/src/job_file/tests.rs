use std::fs;

use super::*;
use crate::command_line::{Refusal, read};
use crate::options::{Command as Sub, PlanOptions};

fn line(words: &[&str]) -> Vec<OsString> {
    std::iter::once("patchmill").chain(words.iter().copied()).map(OsString::from).collect()
}

fn plan(words: &[&str]) -> Result<PlanOptions, String> {
    let typed = std::iter::once("plan").chain(words.iter().copied()).collect::<Vec<_>>();
    match read(line(&typed)) {
        Ok(CommandLine { command: Sub::Plan(options) }) => Ok(*options),
        Ok(other) => Err(format!("{other:?}")),
        Err(Refusal::JobFile(text)) => Err(text),
        Err(Refusal::Usage(e)) => Err(e.to_string()),
    }
}

/// Everything that says how and what is planned, but for the places of files.
fn job(options: &PlanOptions) -> String {
    format!(
        "{:?} {:?} {:?} {:?} {:?}",
        options.jobs(),
        options.dialect,
        options.cloud,
        options.job.units,
        options.job.select.iter().map(|condition| condition.rule.clone()).collect::<Vec<_>>()
    )
}

/// A folder with a surface, facets and a job file of this text.
struct Folder(tempfile::TempDir);

impl Folder {
    fn with(job: &str) -> Self {
        let folder = Self(tempfile::tempdir().unwrap());
        fs::write(folder.0.path().join("s.stl"), "").unwrap();
        fs::write(folder.0.path().join("facets.txt"), "1..5").unwrap();
        fs::write(folder.0.path().join("m.urdf"), "").unwrap();
        fs::create_dir(folder.0.path().join("sub")).unwrap();
        fs::write(folder.path("job.yaml"), job).unwrap();
        folder
    }

    fn path(&self, name: &str) -> String {
        self.0.path().join(name).to_string_lossy().into_owned()
    }

    fn plan(&self, words: &[&str]) -> Result<PlanOptions, String> {
        let file = self.path("job.yaml");
        plan(&[&["--job", &file, "--out", "d"], words].concat())
    }
}

const EVERYTHING: &[&str] = &[
    "--tool",
    "r1=0,r2=6,flute=25,shank=10",
    "--tool",
    "r1=4,r2=4",
    "--strategy",
    "rolling-ball",
    "--patches",
    "2..5",
    "--holder",
    "d=20..32,l=30;d=63,l=25",
    "--scallop",
    "0.01",
    "--gouge-tolerance",
    "0.004",
    "--pattern",
    "climb",
    "--mount",
    "-90,-60,70,0,0,0",
    "--units",
    "in",
    "--select",
    "z=-5..20",
    "--allow-rest=40",
    "--feed",
    "1500",
    "--spindle",
    "4000",
    "--stock-allowance",
    "0.1",
    "--lead-min",
    "3",
    "--inclination-max",
    "60",
    "--acceleration-linear",
    "4",
    "--acceleration-rotary",
    "15",
    "--jerk-linear",
    "50",
    "--jerk-rotary",
    "200",
    "--block-time",
    "1",
    "--look-ahead",
    "linear-axes",
    "--path-tolerance",
    "0.005",
    "--lead-radius",
    "1.5",
    "--border-margin",
    "3",
    "--dialect",
    "siemens",
    "--dialect",
    "fanuc",
];

/// What is left to other tests below, or is no part of a job. An option that is neither here nor above fails the test.
const ELSEWHERE: [&str; 12] = [
    "surface",
    "cloud",
    "cloud_wait",
    "out",
    "machine",
    "rest_of",
    "params_file",
    "param",
    "domain",
    "namespace",
    "json",
    "verbose",
];

#[test]
fn every_option_goes_into_the_file_and_comes_back() {
    let folder = Folder::with("");
    let (surface, machine) = (folder.path("s.stl"), folder.path("m.urdf"));
    let facets = format!("facets={}", folder.path("facets.txt"));
    let plan_before = folder.path("before");
    fs::create_dir(&plan_before).unwrap();
    let more = ["--machine", &machine, "--select", &facets, "--rest-of", &plan_before, &surface];
    let typed = plan(&[EVERYTHING, &more, &["--out", "d"]].concat()).unwrap();
    // The file lies elsewhere than what it names.
    let text = typed.run.effective.text(&[], Path::new(&folder.path("sub"))).unwrap();
    assert!(text.contains("surface: ../s.stl\n") && text.contains("machine: ../m.urdf\n"), "{text}");
    assert!(text.contains("\"facets=../facets.txt\"") && text.contains("feed_mm_per_min: 1500\n"), "{text}");
    let file = folder.path("sub/job.yaml");
    fs::write(&file, &text).unwrap();
    let again = plan(&["--job", &file, "--out", "d"]).unwrap();
    assert_eq!(job(&again), job(&typed));
    let same = |a: &Option<PathBuf>, b: &str| {
        a.as_ref().unwrap().canonicalize().unwrap() == Path::new(b).canonicalize().unwrap()
    };
    assert!(same(&again.surface, &surface) && same(&again.job.machine, &machine));
    assert!(same(&again.rest_of, &plan_before));
    assert_eq!(again.run.effective.text(&[], Path::new(&folder.path("sub"))).unwrap(), text);

    let mut root = CommandLine::command();
    root.build();
    for argument in arguments(root.find_subcommand("plan").unwrap()) {
        let long = format!("--{}", argument.get_long().unwrap_or_default());
        let id = argument.get_id().as_str();
        assert!(
            EVERYTHING.iter().any(|typed| typed.split('=').next() == Some(&*long))
                || ELSEWHERE.contains(&id)
                || id == "select",
            "{id} is not tested"
        );
        assert_eq!(
            text.contains(&format!("\n{}:", key(argument))),
            !ELSEWHERE.contains(&id)
                || ["surface", "cloud", "cloud_wait", "machine", "rest_of"].contains(&id),
            "{id}"
        );
    }
}

#[test]
fn defaults_are_written_and_may_be_read_beside_anything() {
    let folder = Folder::with("");
    let typed = plan(&[&folder.path("s.stl"), "--out", "d"]).unwrap();
    let text = typed.run.effective.text(&[], folder.0.path()).unwrap();
    assert!(text.contains("scallop_mm: 0.0254\n") && text.contains("cloud: false\n"), "{text}");
    fs::write(folder.path("job.yaml"), &text).unwrap();
    assert_eq!(job(&folder.plan(&[]).unwrap()), job(&typed));
}

#[test]
fn what_is_typed_outweighs_the_file_and_what_it_excludes_goes() {
    let folder = Folder::with(
        "surface: s.stl\nunits: in\nfeed_mm_per_min: 900\nscallop_mm: 0.02\ntool: [\"r1=0,r2=6\", \"r1=0,r2=5\"]\nout: o\n",
    );
    let file = folder.path("job.yaml");
    let options = plan(&["--feed", "1200", "--job", &file, "--tool", "r1=1,r2=2"]).unwrap();
    assert_eq!((options.job.feed, options.job.scallop, options.tool.len()), (1200.0, 0.02, 1));
    assert_eq!(options.surface.unwrap(), folder.0.path().join("s.stl"));
    assert_eq!(options.out, folder.0.path().join("o"));
    assert_eq!(folder.plan(&["other.stl"]).unwrap().surface.unwrap(), Path::new("other.stl"));
    let cloud = folder.plan(&["--cloud", "--domain", "3"]).unwrap();
    assert!(cloud.cloud && cloud.surface.is_none() && cloud.job.units.is_none());
    // The stack has the cloud: it belongs to the job then.
    let text = cloud.run.effective.text(&[], folder.0.path()).unwrap();
    assert!(text.contains("cloud: true\n") && text.contains("domain: 3\n"), "{text}");
    let apart = folder.plan(&["--domain", "3"]).unwrap().run.effective.text(&[], folder.0.path()).unwrap();
    assert!(!apart.contains("domain:") && apart.contains("nodes of ROS domain 3"), "{apart}");
}

#[test]
fn parameters_keep_their_weights() {
    let folder = Folder::with("surface: s.stl\nparam: [\"shadow:=exact\"]\nparams_file: nodes.yaml\n");
    let parameters = "/**:\n  ros__parameters:\n    shadow: circles\n    samples_per_side: 30\n";
    fs::write(folder.path("nodes.yaml"), parameters).unwrap();
    let last = |options: &PlanOptions, name: &str| {
        let read = options.parameters.read(&[]).unwrap();
        read.iter().rev().find(|over| over.name == name).unwrap().value.to_string()
    };
    let options = folder.plan(&[]).unwrap();
    assert_eq!((&*last(&options, "shadow"), &*last(&options, "samples_per_side")), ("'exact'", "30"));
    let typed = folder.path("typed.yaml");
    fs::write(&typed, parameters).unwrap();
    assert_eq!(last(&folder.plan(&["--params-file", &typed]).unwrap(), "shadow"), "'circles'");
    // All of them are in the file of the plan, which needs no other.
    let all = options.parameters.read(&[]).unwrap();
    let text = options.run.effective.text(&all, folder.0.path()).unwrap();
    assert!(!text.contains("params_file") && text.contains("samples_per_side:=30"), "{text}");
    fs::write(folder.path("job.yaml"), text).unwrap();
    assert_eq!(folder.plan(&[]).unwrap().parameters.read(&[]).unwrap(), all);
}

#[test]
fn what_is_wrong_is_named_with_file_line_key_value_and_expectation() {
    for (bad, words) in [
        ("surface: s.stl\nscallop: 1\n", &["job.yaml", "line 2", "scallop", "scallop_mm meant"][..]),
        ("scallop_mm: 0\n", &["line 1: scallop_mm", "`0`", "not above 0", "mm"]),
        ("\nfeed_mm_per_min: quick\n", &["line 2", "`quick`", "finite number", "mm/min"]),
        ("feed_mm_per_min: [1, 2]\n", &["list of 2", "one value"]),
        ("pattern: zag\n", &["`zag`", "zigzag, one-way, climb"]),
        ("cloud: perhaps\n", &["`perhaps`", "true nor false"]),
        ("domain: 900\n", &["`900`", "0..=232"]),
        ("select: [z=1]\n", &["`z=1`", "MIN..MAX"]),
        ("tool: [\"r1=0,r2=6\", \"r1=0\"]\n", &["`r1=0`", "r1 and r2 are needed"]),
        ("job: other.yaml\n", &["no such key"]),
        ("colour: red\n", &["no such key", "expected one of surface, cloud,"]),
        ("units: furlong\n", &["`furlong`", "mm, m, in"]),
        ("feed: {}\n", &["nothing nested"]),
    ] {
        let text = Folder::with(bad).plan(&["s.stl"]).unwrap_err();
        assert!(words.iter().all(|word| text.contains(word)) && !text.contains('\n'), "{bad:?}: {text}");
    }
    let text = plan(&["--job", "no_such.yaml", "s.stl", "--out", "d"]).unwrap_err();
    assert!(text.contains("job file no_such.yaml"), "{text}");
}

#[test]
fn a_comparison_has_a_job_file_too() {
    let folder = Folder::with("surface: s.stl\nstock: [\"r1=0,r2=3\"]\npatches: 1..2\n");
    let file = folder.path("job.yaml");
    match read(line(&["compare", "--job", &file, "--out", "d"])).unwrap().command {
        Sub::Compare(options) => assert_eq!((options.stock.len(), options.patches), (1, 1..=2)),
        other => panic!("{other:?}"),
    }
    // Other commands have none, and a line without one stays as it is.
    assert!(matches!(read(line(&["up", "--job", &file])), Err(Refusal::Usage(_))));
    for typed in
        [line(&["plan", "s.stl", "--out", "d"]), line(&[]), line(&["--help"]), line(&["plan", "--job"])]
    {
        assert_eq!(merged(typed.clone()).unwrap(), Merged { arguments: typed, parameters: Vec::new() });
    }
}
