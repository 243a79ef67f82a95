//! The keys of a job file: the options of the command themselves, so that none can be forgotten. A key is the option's name with `_`
//! and, where it is a plain number, its unit: `--lead-min DEG` is `lead_min_deg`.

use clap::builder::ValueHint;
use clap::{Arg, ArgAction, Command};

/// Units as the command line names them and as they end a key.
pub const UNITS: [(&str, &str); 10] = [
    ("MM", "mm"),
    ("DEG", "deg"),
    ("S", "s"),
    ("MS", "ms"),
    ("RPM", "rpm"),
    ("MM/MIN", "mm_per_min"),
    ("M/S2", "m_per_s2"),
    ("M/S3", "m_per_s3"),
    ("RAD/S2", "rad_per_s2"),
    ("RAD/S3", "rad_per_s3"),
];

/// Options that a job file cannot hold: itself, and what clap adds.
const OUTSIDE: [&str; 3] = ["job_file", "help", "version"];

/// What a value names besides itself.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Holds {
    /// Nothing.
    Text,
    /// A file or folder.
    Path,
    /// A shipped machine or a file.
    Machine,
    /// A condition of `--select`, of which one kind names a file.
    Condition,
}

impl Holds {
    /// Of an option's values.
    pub fn of(argument: &Arg) -> Self {
        match (argument.get_id().as_str(), argument.get_value_hint()) {
            ("machine", _) => Self::Machine,
            ("select", _) => Self::Condition,
            (_, ValueHint::AnyPath | ValueHint::FilePath | ValueHint::DirPath) => Self::Path,
            _ => Self::Text,
        }
    }
}

/// The options that a job file of a command may hold, in their order.
pub fn arguments(command: &Command) -> impl Iterator<Item = &Arg> {
    command.get_arguments().filter(|argument| !OUTSIDE.contains(&argument.get_id().as_str()))
}

/// The key of an option.
pub fn key(argument: &Arg) -> String {
    let name = argument.get_long().unwrap_or(argument.get_id().as_str()).replace('-', "_");
    let unit = argument.get_value_names().and_then(|names| {
        let [name] = names else { return None };
        UNITS.iter().find(|(typed, _)| name.as_str() == *typed).map(|(_, key)| *key)
    });
    unit.map_or(name.clone(), |unit| format!("{name}_{unit}"))
}

/// Whether an option may be given several times.
pub fn is_list(argument: &Arg) -> bool {
    matches!(argument.get_action(), ArgAction::Append)
}

/// Whether an option is there or not, without a value.
pub fn is_flag(argument: &Arg) -> bool {
    matches!(argument.get_action(), ArgAction::SetTrue)
}

#[cfg(test)]
mod tests {
    use clap::CommandFactory;

    use super::*;
    use crate::options::CommandLine;

    /// What options take that has no unit, or names it within the text.
    const OTHERS: [&str; 14] = [
        "SURFACE",
        "DIR",
        "FILE",
        "r1=MM,r2=MM,length=MM,flute=MM,shank=MM",
        "r1=MM,r2=MM,length=MM",
        "d=MM[..MM],l=MM;...",
        "N|N..M",
        "N",
        "/NAME",
        "NAME|FILE.urdf",
        "X,Y,Z,ROLL,PITCH,YAW|auto",
        "UNIT",
        "CONDITION",
        "CONTROL",
    ];

    #[test]
    fn every_number_has_its_unit_in_its_key() {
        let mut root = CommandLine::command();
        root.build();
        for name in ["plan", "compare"] {
            let command = root.find_subcommand(name).unwrap();
            for argument in arguments(command).filter(|a| !is_flag(a)) {
                let value = argument.get_value_names().unwrap()[0].as_str();
                let choice = !argument.get_possible_values().is_empty() && argument.get_long().is_some();
                let known = UNITS.iter().any(|(unit, _)| *unit == value) || OTHERS.contains(&value);
                let parameter = value == "[NODE:]NAME:=VALUE";
                assert!(choice || known || parameter, "{name}: --{:?} {value}: a unit?", argument.get_long());
            }
        }
        let plan = root.find_subcommand("plan").unwrap();
        let keys: Vec<String> = arguments(plan).map(key).collect();
        for key in [
            "surface",
            "cloud",
            "cloud_wait_s",
            "feed_mm_per_min",
            "jerk_linear_m_per_s3",
            "lead_min_deg",
            "mount",
        ] {
            assert!(keys.iter().any(|k| k == key), "{key}: {keys:?}");
        }
        assert!(!keys.contains(&"job".to_owned()));
    }
}
