//! SROS2: whether the environment asks for protection, and the files of a keystore that a participant takes then.
//!
//! The variables, the layout of a keystore (`enclaves/NAME/…`) and the file names are those of ROS 2 (design article "ROS 2 DDS-Security
//! integration"; `rcl/security.c`, `rmw_dds_common/security.cpp`), so that `ros2 security` makes keystores for patchmill and
//! `launch_scripts/keystore.sh` for anybody. It is stricter in three things: enforced unless ROS_SECURITY_STRATEGY says Permissive, any value
//! of ROS_SECURITY_ENABLE but `true` and `false` is an error, and what the library cannot do is refused instead of left out.

use std::path::{Path, PathBuf};

use ros2_client::dds::rustdds::DomainParticipantBuilder;

use crate::RuntimeError;
use crate::log::say_on_stderr;

/// The enclave of a process that is told no other.
pub const DEFAULT_ENCLAVE: &str = "/patchmill";

/// All of them are needed.
const FILES: [&str; 6] = [
    "identity_ca.cert.pem",
    "cert.pem",
    "key.pem",
    "permissions_ca.cert.pem",
    "governance.p7s",
    "permissions.p7s",
];

/// A list of revoked certificates, which rustdds would not look at.
const REVOKED: &str = "crl.pem";

const BUILT_WITHOUT: &str = "ROS_SECURITY_ENABLE is true, but this executable has been built without SROS2: build it by \
    `cargo build --release --workspace --features security`, or set ROS_SECURITY_ENABLE=false to run unprotected";

/// What the environment asks for.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Protection {
    /// ROS_SECURITY_ENABLE is not set or `false`.
    Off,
    /// With the files of this folder.
    Enclave(PathBuf),
    /// It was asked for, but the strategy is Permissive and there are no files, as the text tells.
    Missing(String),
}

/// What the environment asks for, in the enclave that the command line names (the environment outweighs it).
///
/// # Errors
/// [`RuntimeError::Security`] when a variable has an unknown value, a file is missing and the strategy is not Permissive, or this
/// executable has been built without protection.
pub fn protection(
    enclave: Option<&str>,
    environment: impl Fn(&str) -> Option<String>,
) -> Result<Protection, RuntimeError> {
    let variable = |name: &str| environment(name).filter(|v| !v.is_empty());
    match variable("ROS_SECURITY_ENABLE").as_deref() {
        None | Some("false") => return Ok(Protection::Off),
        Some("true") => {}
        Some(other) => {
            return Err(refused(format!("ROS_SECURITY_ENABLE is '{other}': expected true or false")));
        }
    }
    if !cfg!(feature = "security") {
        return Err(refused(BUILT_WITHOUT));
    }
    let permissive = match variable("ROS_SECURITY_STRATEGY").as_deref() {
        None | Some("Enforce") => false,
        Some("Permissive") => true,
        Some(other) => {
            return Err(refused(format!(
                "ROS_SECURITY_STRATEGY is '{other}': expected Enforce or Permissive"
            )));
        }
    };
    let override_of = variable("ROS_SECURITY_ENCLAVE_OVERRIDE");
    let enclave = override_of.as_deref().or(enclave).unwrap_or(DEFAULT_ENCLAVE);
    match enclave_directory(variable("ROS_SECURITY_KEYSTORE").as_deref(), enclave) {
        Ok(directory) => Ok(Protection::Enclave(directory)),
        Err(Unusable::Missing(text)) if permissive => Ok(Protection::Missing(text)),
        Err(Unusable::Missing(text) | Unusable::Refused(text)) => Err(refused(text)),
    }
}

/// Why an enclave cannot be used.
enum Unusable {
    /// A file is not there: nothing to be had under Permissive either.
    Missing(String),
    /// What is there asks for what cannot be given.
    Refused(String),
}

/// The enclave's folder, with all its files.
fn enclave_directory(keystore: Option<&str>, enclave: &str) -> Result<PathBuf, Unusable> {
    let Some(keystore) = keystore else {
        return Err(Unusable::Missing(
            "ROS_SECURITY_ENABLE is true, but ROS_SECURITY_KEYSTORE names no keystore: make one by `bash launch_scripts/keystore.sh DIR`"
                .to_owned(),
        ));
    };
    if !is_enclave(enclave) {
        return Err(Unusable::Refused(format!(
            "enclave '{enclave}': expected an absolute name such as {DEFAULT_ENCLAVE}"
        )));
    }
    let directory = Path::new(keystore).join("enclaves").join(enclave.trim_start_matches('/'));
    if let Some(missing) = FILES.into_iter().find(|file| !directory.join(file).is_file()) {
        return Err(Unusable::Missing(format!(
            "enclave {enclave}: {} is missing: make it by `bash launch_scripts/keystore.sh {keystore} {enclave}` (or `ros2 security \
             create_enclave`), or name another enclave by ROS_SECURITY_ENCLAVE_OVERRIDE",
            directory.join(missing).display()
        )));
    }
    if directory.join(REVOKED).exists() {
        return Err(Unusable::Refused(format!(
            "enclave {enclave}: {} is there, but revoked certificates cannot be told from others here: make a new keystore instead, and \
             remove the list",
            directory.join(REVOKED).display()
        )));
    }
    Ok(directory)
}

/// `/` or `/name/name`, so that no enclave lies outside the keystore.
fn is_enclave(name: &str) -> bool {
    let token = |token: &str| {
        !token.is_empty()
            && !token.starts_with(|c: char| c.is_ascii_digit())
            && token.chars().all(|c| c.is_ascii_alphanumeric() || c == '_')
    };
    name == "/" || name.strip_prefix('/').is_some_and(|names| names.split('/').all(token))
}

/// The same with what the process's environment asks for. What is left unprotected by a Permissive strategy says so on stderr.
pub(crate) fn protected(
    builder: DomainParticipantBuilder,
    enclave: Option<&str>,
) -> Result<DomainParticipantBuilder, RuntimeError> {
    // Lossy: what is no UTF-8 is an unknown value, not an unset variable.
    let environment = |name: &str| std::env::var_os(name).map(|v| v.to_string_lossy().into_owned());
    match protection(enclave, environment)? {
        Protection::Off => Ok(builder),
        Protection::Enclave(directory) => with_files(builder, &directory),
        Protection::Missing(text) => {
            say_on_stderr(format_args!(
                "RUNNING UNPROTECTED, as ROS_SECURITY_STRATEGY=Permissive allows: {text}"
            ));
            Ok(builder)
        }
    }
}

#[cfg(feature = "security")]
fn with_files(
    builder: DomainParticipantBuilder,
    directory: &Path,
) -> Result<DomainParticipantBuilder, RuntimeError> {
    use ros2_client::dds::rustdds::DomainParticipantSecurityConfigFiles;
    // No password: one that were given would not be used by rustdds, and a key that needs one is refused when it is read.
    let files = DomainParticipantSecurityConfigFiles::with_ros_default_names(directory, String::new());
    Ok(builder.builtin_security(files))
}

#[cfg(not(feature = "security"))]
fn with_files(_: DomainParticipantBuilder, _: &Path) -> Result<DomainParticipantBuilder, RuntimeError> {
    Err(refused(BUILT_WITHOUT))
}

fn refused(text: impl Into<String>) -> RuntimeError {
    RuntimeError::Security(text.into())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(enclave: Option<&str>, pairs: &[(&str, &str)]) -> Result<Protection, String> {
        let value = |name: &str| pairs.iter().find(|(n, _)| *n == name).map(|(_, v)| (*v).to_owned());
        protection(enclave, value).map_err(|e| e.to_string())
    }

    #[test]
    fn protection_is_off_unless_enabled_and_other_words_are_errors() {
        assert_eq!(of(None, &[]), Ok(Protection::Off));
        assert_eq!(of(None, &[("ROS_SECURITY_ENABLE", "")]), Ok(Protection::Off));
        assert_eq!(
            of(Some("/x"), &[("ROS_SECURITY_ENABLE", "false"), ("ROS_SECURITY_KEYSTORE", "k")]),
            Ok(Protection::Off)
        );
        for word in ["1", "TRUE", "yes"] {
            let expected = format!("ROS_SECURITY_ENABLE is '{word}': expected true or false");
            assert_eq!(of(None, &[("ROS_SECURITY_ENABLE", word)]), Err(expected));
        }
    }

    #[cfg(not(feature = "security"))]
    #[test]
    fn an_executable_without_it_refuses_whatever_the_strategy() {
        for strategy in ["", "Enforce", "Permissive"] {
            let told = of(None, &[("ROS_SECURITY_ENABLE", "true"), ("ROS_SECURITY_STRATEGY", strategy)]);
            assert_eq!(told, Err(BUILT_WITHOUT.to_owned()));
        }
    }

    #[cfg(feature = "security")]
    #[test]
    fn the_enclave_is_found_or_its_first_missing_file_named() {
        let folder = tempfile::tempdir().unwrap();
        let keystore = folder.path().to_str().unwrap();
        let directory = folder.path().join("enclaves/cell/a");
        std::fs::create_dir_all(&directory).unwrap();
        for file in FILES {
            std::fs::write(directory.join(file), "").unwrap();
        }
        let on = [("ROS_SECURITY_ENABLE", "true"), ("ROS_SECURITY_KEYSTORE", keystore)];
        let with = |name: &'static str, value: &'static str| [on[0], on[1], (name, value)];
        assert_eq!(of(Some("/cell/a"), &on), Ok(Protection::Enclave(directory.clone())));
        let overridden = with("ROS_SECURITY_ENCLAVE_OVERRIDE", "/cell/a");
        assert_eq!(of(Some("/x"), &overridden), Ok(Protection::Enclave(directory.clone())));

        std::fs::remove_file(directory.join("governance.p7s")).unwrap();
        let missing = of(Some("/cell/a"), &on).unwrap_err();
        assert!(missing.contains("enclaves/cell/a/governance.p7s is missing: make it by"), "{missing}");
        assert!(of(None, &on).unwrap_err().contains("enclaves/patchmill/identity_ca.cert.pem is missing"));
        assert!(of(None, &on[..1]).unwrap_err().contains("ROS_SECURITY_KEYSTORE names no keystore"));
        let permissive = with("ROS_SECURITY_STRATEGY", "Permissive");
        assert_eq!(of(Some("/cell/a"), &permissive), Ok(Protection::Missing(missing)));
        let unknown = of(None, &with("ROS_SECURITY_STRATEGY", "enforce")).unwrap_err();
        assert_eq!(unknown, "ROS_SECURITY_STRATEGY is 'enforce': expected Enforce or Permissive");

        std::fs::write(directory.join("governance.p7s"), "").unwrap();
        std::fs::write(directory.join(REVOKED), "").unwrap();
        assert!(of(Some("/cell/a"), &permissive).unwrap_err().contains("crl.pem is there"));
        for name in ["cell/a", "/../cell", "/cell//a", "/cell/", ""] {
            assert!(of(Some(name), &permissive).unwrap_err().contains("expected an absolute name"), "{name}");
        }
    }
}
