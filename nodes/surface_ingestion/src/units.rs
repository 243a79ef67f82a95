//! Units of surface files.

use patchmill_products::stage::StageError;

use crate::error_code::BAD_UNITS;

/// Metres in one `units`: mm (also when empty), m or in.
///
/// # Errors
/// For any other text.
pub fn metres_per_unit(units: &str) -> Result<f64, StageError> {
    match units {
        "" | "mm" => Ok(1e-3),
        "m" => Ok(1.0),
        "in" => Ok(0.0254),
        other => {
            let shown: String = other.chars().take(40).collect();
            Err(StageError::new(
                BAD_UNITS,
                format!("the unit \"{shown}\" is unknown; mm, m or in was expected"),
            ))
        }
    }
}
