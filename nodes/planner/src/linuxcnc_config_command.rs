//! `patchmill linuxcnc-config`: a machine's LinuxCNC simulation.

use std::fs;
use std::os::unix::fs::PermissionsExt;

use patchmill_machine_interface::DEFAULT_MACHINE_URDF;
use patchmill_machine_interface::evaluate::machine_of;
use patchmill_machine_interface::linuxcnc::config::config_files;
use patchmill_products::job::Job;

use crate::machine_file::machine_text;
use crate::options::LinuxcncConfigOptions;
use crate::output_folder::OutputFolder;
use crate::stdout::say;
use crate::terminal;

/// Writes the configuration.
///
/// # Errors
/// When the machine cannot be used, or the folder is not empty or cannot be written.
pub fn linuxcnc_config(options: &LinuxcncConfigOptions) -> Result<(), String> {
    if fs::read_dir(&options.out).is_ok_and(|mut entries| entries.next().is_some()) {
        return Err(format!(
            "output folder {}: it is not empty; expected one that is, or a new name",
            options.out.display()
        ));
    }
    let job = Job {
        tool: options.tool.clone(),
        acceleration_linear: options.acceleration_linear,
        acceleration_rotary: options.acceleration_rotary,
        machine_urdf: machine_text(options.machine.as_deref(), terminal::warn)?,
        ..Job::default_for("")
    };
    let (machine, _) = machine_of(&job, DEFAULT_MACHINE_URDF).map_err(|e| e.text)?;
    let folder = OutputFolder::create(&options.out)?;
    for file in config_files(&machine, &options.tool, options.port).map_err(|e| e.to_string())? {
        folder.write(file.name, file.text.as_bytes())?;
        if file.executable {
            let mode = fs::Permissions::from_mode(0o755);
            let path = folder.staging().join(file.name);
            fs::set_permissions(&path, mode).map_err(|e| format!("{}: {e}", path.display()))?;
        }
    }
    folder.commit()?;
    say(&format!(
        "LinuxCNC simulation of {} in {dir}\nstart it: bash {dir}/start.sh\nrun a plan: patchmill execute PLAN --controller linuxcnc://127.0.0.1:{}\n",
        machine.name(),
        options.port,
        dir = options.out.display(),
    ))
}
