//! What a reader gives: triangles over vertices, or points only, in the file's unit and order.

use nalgebra::Point3;

/// Triangles over vertices; indices are in range, coordinates finite.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RawMesh {
    /// Vertices, some of them maybe equal.
    pub vertices: Vec<Point3<f64>>,
    /// Vertex indices, three a triangle.
    pub triangles: Vec<[u32; 3]>,
}

/// The points of a scan, coordinates finite. What else a file holds (normals, colours, intensity) is not read: normals are
/// fitted, and the tool side is +Z, as for meshes.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RawCloud {
    /// The points.
    pub points: Vec<Point3<f64>>,
    /// Points left out because the file marks them, by a coordinate that is not finite, as no return of the scanner.
    pub no_return: usize,
}

/// A mesh or the points of a scan.
#[derive(Clone, Debug, PartialEq)]
pub enum Raw {
    /// Triangles.
    Mesh(RawMesh),
    /// Points.
    Cloud(RawCloud),
}

/// What is read at most. Checked before memory is taken.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Limits {
    /// Triangles of a mesh; it may have three times as many vertices.
    pub triangles: usize,
    /// Points of a cloud.
    pub points: usize,
}

impl Limits {
    /// # Errors
    /// When `count` triangles (or polygons, which have at least one each) of a `format` file are too many.
    pub fn check_triangles(&self, count: usize, format: &str) -> Result<(), String> {
        if count > self.triangles {
            return Err(format!(
                "the {format} has {count} facets, more than the {} allowed (max_triangles)",
                self.triangles
            ));
        }
        Ok(())
    }

    /// # Errors
    /// When `count` vertices of a mesh in a `format` file are too many.
    pub fn check_vertices(&self, count: usize, format: &str) -> Result<(), String> {
        let most = self.triangles.saturating_mul(3).min(u32::MAX as usize);
        if count > most {
            return Err(format!(
                "the {format} has {count} vertices, more than the {most} allowed (three times max_triangles)"
            ));
        }
        Ok(())
    }

    /// # Errors
    /// When `count` points of a cloud in a `format` file are too many.
    pub fn check_points(&self, count: usize, format: &str) -> Result<(), String> {
        if count > self.points {
            return Err(format!(
                "the {format} has {count} points, more than the {} allowed (max_points)",
                self.points
            ));
        }
        Ok(())
    }
}
