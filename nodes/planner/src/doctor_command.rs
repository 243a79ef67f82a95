//! `patchmill doctor`: what the stack needs of this machine, line by line.

use std::time::Duration;

use patchmill_node_runtime::{Build, peers};
use serde::Serialize;

use crate::doctor::Finding;
use crate::doctor::controller::controller;
use crate::doctor::disk::disk;
use crate::doctor::machine::machine;
use crate::doctor::multicast::multicast;
use crate::doctor::network::network;
use crate::doctor::sockets::sockets;
use crate::doctor::stack::stack;
use crate::options::DoctorOptions;
use crate::stdout::{say, say_json};
use crate::terminal::Mood;

/// What `--json` prints.
#[derive(Serialize)]
struct Document<'a> {
    patchmill_version: &'static str,
    well: bool,
    findings: &'a [Finding],
}

/// Looks at everything and prints it. `true` where nothing is amiss.
///
/// # Errors
/// When the findings cannot be written; what cannot be looked at is a finding.
pub async fn doctor(options: &DoctorOptions) -> Result<bool, String> {
    let findings = findings(options).await;
    let well = findings.iter().all(|finding| finding.state != Mood::Bad);
    if options.json {
        let patchmill_version = env!("CARGO_PKG_VERSION");
        say_json(&Document { patchmill_version, well, findings: &findings })?;
    } else {
        say(&findings.iter().map(Finding::text).collect::<String>())?;
    }
    Ok(well)
}

async fn findings(options: &DoctorOptions) -> Vec<Finding> {
    let (domain, arguments) = network(options.domain, |variable| std::env::var(variable).ok());
    let mut findings = vec![domain, multicast(), sockets(), disk(&options.out)];
    if let Some(arguments) = arguments {
        let domain = arguments.domain;
        match peers(arguments, Duration::from_secs_f64(options.wait)).await {
            Ok(peers) => findings.extend(stack(domain, &peers, &Build::own())),
            Err(e) => findings.push(Finding::bad(
                "peers",
                format!("domain {domain} cannot be joined: {e}"),
                "see whether a network interface is up (ip link) and UDP sockets are allowed, or take another --domain",
            )),
        }
    }
    findings.extend(machine(options.machine.as_deref()));
    findings.extend(options.controller.as_deref().map(controller));
    findings
}
