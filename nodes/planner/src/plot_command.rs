//! `patchmill plot`: a picture of a finished plan.

use std::path::Path;

use patchmill_report::{Format, What, picture};

use crate::options::{PlotOption, PlotOptions};
use crate::output_folder::replace;
use crate::report_command::finished_plan;
use crate::stdout::say;

/// Draws a picture.
///
/// # Errors
/// With one sentence: a file that is neither PNG nor SVG by its name, a folder without a plan, or a file that cannot be written.
pub fn plot(options: &PlotOptions) -> Result<(), String> {
    let format = format_of(&options.out)?;
    let what = match options.what {
        PlotOption::Patches => What::Patches,
        PlotOption::Radius => What::Radius,
        PlotOption::Residual => What::Residual,
        PlotOption::Passes => What::Passes,
        PlotOption::Time => What::Time,
    };
    replace(&options.out, &picture(&finished_plan(&options.plan)?, what, format)?)?;
    say(&format!("written: {}\n", options.out.display()))
}

fn format_of(file: &Path) -> Result<Format, String> {
    let extension = file.extension().map(|e| e.to_string_lossy().to_lowercase());
    match extension.as_deref() {
        Some("png") => Ok(Format::Png),
        Some("svg") => Ok(Format::Svg),
        _ => Err(format!(
            "{}: no picture by its name; expected a file that ends in .png or .svg",
            file.display()
        )),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_name_tells_the_format() {
        assert_eq!(format_of(Path::new("a/b.PNG")), Ok(Format::Png));
        assert_eq!(format_of(Path::new("b.svg")), Ok(Format::Svg));
        for bad in ["b.jpg", "png", "b.", ".svg"] {
            assert!(format_of(Path::new(bad)).unwrap_err().contains(".png or .svg"), "{bad}");
        }
    }
}
