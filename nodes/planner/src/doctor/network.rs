//! ROS domain and discovery range, as the environment and the option have them.

use patchmill_node_runtime::{Arguments, Level};

use super::Finding;

const CHECK: &str = "ROS domain";
/// Above it the ports of DDS reach into those that Linux gives to anybody (32768 on).
const LAST_SAFE_DOMAIN: u16 = 101;

/// The arguments of a node that the doctor starts there; `None` where the environment is wrong.
pub fn network(
    domain: Option<u16>,
    environment: impl Fn(&str) -> Option<String>,
) -> (Finding, Option<Arguments>) {
    let arguments = match Arguments::parse(std::iter::empty(), "patchmill_doctor", environment) {
        Ok(arguments) => arguments,
        Err(e) => return (Finding::bad(CHECK, e.to_string(), "set the variable so, or unset it"), None),
    };
    let domain = domain.unwrap_or(arguments.domain);
    let range = if arguments.local_only {
        "nodes see this machine only (ROS_AUTOMATIC_DISCOVERY_RANGE=SUBNET opens it)"
    } else {
        "nodes see the subnet (ROS_AUTOMATIC_DISCOVERY_RANGE=SUBNET)"
    };
    let found = format!("{domain}; {range}");
    let finding = if domain > LAST_SAFE_DOMAIN {
        let advice =
            format!("take a domain up to {LAST_SAFE_DOMAIN}: other programs may hold this one's ports");
        Finding::doubtful(CHECK, found, advice)
    } else {
        Finding::good(CHECK, found)
    };
    (finding, Some(Arguments { domain, log_level: Level::Fatal, ..arguments }))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::terminal::Mood;

    #[test]
    fn the_option_outweighs_the_environment_and_wrong_values_are_named() {
        let of = |pairs: &'static [(&str, &str)], domain| {
            let value = |name: &str| pairs.iter().find(|(n, _)| *n == name).map(|(_, v)| (*v).to_owned());
            network(domain, value)
        };
        let (finding, arguments) = of(&[("ROS_DOMAIN_ID", "7")], Some(5));
        let arguments = arguments.unwrap();
        assert_eq!((finding.state, arguments.domain, arguments.local_only), (Mood::Good, 5, true));
        let (finding, arguments) =
            of(&[("ROS_DOMAIN_ID", "102"), ("ROS_AUTOMATIC_DISCOVERY_RANGE", "SUBNET")], None);
        assert!(finding.state == Mood::Doubtful && finding.found.contains("102; nodes see the subnet"));
        assert!(!arguments.unwrap().local_only);
        let (finding, arguments) = of(&[("ROS_DOMAIN_ID", "x")], None);
        assert!(finding.state == Mood::Bad && finding.found.contains("ROS_DOMAIN_ID is 'x'"), "{finding:?}");
        assert!(arguments.is_none());
    }
}
