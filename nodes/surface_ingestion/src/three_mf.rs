//! 3MF (3MF Consortium, core specification 1.3, and the production extension's `path`): the meshes of all objects that the build
//! places, with their transforms.

use std::collections::BTreeMap;
use std::io::{BufReader, Cursor, Read, Take};

use nalgebra::{Matrix3, Point3, Vector3};
use quick_xml::Reader;
use quick_xml::events::{BytesStart, Event};
use zip::ZipArchive;

use crate::raw::{Limits, RawMesh};
use crate::text::shown;

/// How a file starts: as every ZIP.
pub const MAGIC: &[u8] = b"PK\x03\x04";
/// Most bytes that all parts that are read have uncompressed, and how many a byte of the package may stand for beyond the first
/// ones: XML has 4 to 20, what is made to fill the memory has 1000.
const CONTENT_BYTES_MAX: u64 = 512 << 20;
const CONTENT_RATIO_MAX: u64 = 100;
const CONTENT_FREE: u64 = 16 << 20;
/// Largest tag or text within an element, bytes: it is in memory at once.
const TAG_BYTES_MAX: u64 = 16 << 20;
/// Most parts that hold models, components within one another, objects, and objects placed.
const PARTS_MAX: usize = 1000;
const DEPTH_MAX: usize = 16;
const OBJECTS_MAX: usize = 100_000;
const PLACED_MAX: usize = 10_000;

/// The package, and the bytes that may still be unpacked.
struct Archive<'a> {
    zip: ZipArchive<Cursor<&'a [u8]>>,
    left: u64,
}

/// The mesh of `bytes` in the model's unit, and that unit in metres.
///
/// # Errors
/// Naming the part and byte: no ZIP, no model, XML or numbers that are not valid, triangles or objects that do not exist; no
/// triangles; more than `limits` allows.
pub fn parse(bytes: &[u8], limits: &Limits) -> Result<(RawMesh, f64), String> {
    let zip = ZipArchive::new(Cursor::new(bytes)).map_err(|e| format!("the 3MF is no valid ZIP: {e}"))?;
    let left = (CONTENT_FREE + CONTENT_RATIO_MAX * bytes.len() as u64).min(CONTENT_BYTES_MAX);
    let mut archive = Archive { zip, left };
    let root = root_model(&mut archive)?;
    let model = Model::read(&mut archive, &root, limits)?;
    let (unit, items) = (model.unit, model.items.clone());
    let mut build = Build {
        archive,
        models: BTreeMap::from([(root.clone(), model)]),
        placed: 0,
        limits,
        mesh: RawMesh::default(),
    };
    for item in &items {
        build.place(&root, item, &Transform::default(), 0)?;
    }
    if build.mesh.triangles.is_empty() {
        return Err(format!("the 3MF has no triangles in the {} items of its build", items.len()));
    }
    Ok((build.mesh, unit))
}

/// An affine map: p ↦ linear · p + shift.
#[derive(Clone)]
struct Transform {
    linear: Matrix3<f64>,
    shift: Vector3<f64>,
}

impl Default for Transform {
    fn default() -> Self {
        Self { linear: Matrix3::identity(), shift: Vector3::zeros() }
    }
}

impl Transform {
    /// Of the attribute's twelve numbers: the images of the axes and of the origin, one after the other.
    fn parse(text: &str) -> Option<Self> {
        let numbers: Vec<f64> =
            text.split_ascii_whitespace().take(13).map(str::parse).collect::<Result<_, _>>().ok()?;
        if numbers.len() != 12 || !numbers.iter().all(|x| x.is_finite()) {
            return None;
        }
        let linear = Matrix3::from_column_slice(&numbers[..9]);
        Some(Self { linear, shift: Vector3::from_column_slice(&numbers[9..]) })
    }

    fn after(&self, first: &Self) -> Self {
        Self { linear: self.linear * first.linear, shift: self.linear * first.shift + self.shift }
    }
}

/// An object placed by the build or by another object.
#[derive(Clone)]
struct Placed {
    object: u32,
    part: Option<String>,
    transform: Transform,
}

#[derive(Default)]
struct Object {
    mesh: RawMesh,
    components: Vec<Placed>,
}

struct Model {
    /// Metres.
    unit: f64,
    objects: BTreeMap<u32, Object>,
    items: Vec<Placed>,
}

struct Build<'a> {
    archive: Archive<'a>,
    models: BTreeMap<String, Model>,
    placed: usize,
    limits: &'a Limits,
    mesh: RawMesh,
}

impl Build<'_> {
    fn place(&mut self, part: &str, placed: &Placed, outer: &Transform, depth: usize) -> Result<(), String> {
        self.placed += 1;
        if self.placed > PLACED_MAX || depth > DEPTH_MAX {
            return Err(format!(
                "the 3MF places more than {PLACED_MAX} objects, or components more than {DEPTH_MAX} deep"
            ));
        }
        let part = placed.part.as_deref().unwrap_or(part);
        if !self.models.contains_key(part) {
            if self.models.len() >= PARTS_MAX {
                return Err(format!("the 3MF has more than {PARTS_MAX} parts with models"));
            }
            let model = Model::read(&mut self.archive, part, self.limits)?;
            self.models.insert(part.to_owned(), model);
        }
        let Some(object) = self.models.get(part).and_then(|m| m.objects.get(&placed.object)) else {
            return Err(format!(
                "the 3MF places object {}, which {} has not",
                placed.object,
                shown(part.as_bytes())
            ));
        };
        let transform = outer.after(&placed.transform);
        self.limits.check_triangles(self.mesh.triangles.len() + object.mesh.triangles.len(), "3MF")?;
        self.limits.check_vertices(self.mesh.vertices.len() + object.mesh.vertices.len(), "3MF")?;
        let first = self.mesh.vertices.len() as u32;
        self.mesh.vertices.extend(
            object.mesh.vertices.iter().map(|p| Point3::from(transform.linear * p.coords + transform.shift)),
        );
        self.mesh.triangles.extend(object.mesh.triangles.iter().map(|t| t.map(|v| v + first)));
        for component in object.components.clone() {
            self.place(part, &component, &transform, depth + 1)?;
        }
        Ok(())
    }
}

/// A reader of the part `name`: of a tag within all that may be unpacked.
fn open<'a, 'b>(
    archive: &'a mut Archive<'b>,
    name: &str,
) -> Result<Reader<Take<BufReader<Take<impl Read + use<'a, 'b>>>>>, String> {
    let file =
        archive.zip.by_name(name).map_err(|e| format!("the 3MF's part {}: {e}", shown(name.as_bytes())))?;
    // The size stated need not be true.
    let content = BufReader::with_capacity(1 << 16, file.take(archive.left));
    Ok(Reader::from_reader(content.take(TAG_BYTES_MAX)))
}

/// Calls `element` with every element's start, `true` for one without content, and with the name of every element that ends.
fn walk(
    archive: &mut Archive<'_>,
    name: &str,
    mut element: impl FnMut(Tag<'_>) -> Result<(), String>,
) -> Result<(), String> {
    let most = archive.left;
    let mut reader = open(archive, name)?;
    let mut buffer = Vec::new();
    loop {
        buffer.clear();
        reader.get_mut().set_limit(TAG_BYTES_MAX);
        let event = reader.read_event_into(&mut buffer);
        let (tag_left, left) = (reader.get_ref().limit(), reader.get_ref().get_ref().get_ref().limit());
        let done = match event {
            _ if left == 0 => Err(format!(
                "the parts have more than {most} bytes unpacked; at most {} MiB, and {CONTENT_RATIO_MAX} for each of the package beyond {} \
                 MiB, were expected",
                CONTENT_BYTES_MAX >> 20,
                CONTENT_FREE >> 20
            )),
            _ if tag_left == 0 => Err(format!("a tag or text is larger than {} MiB", TAG_BYTES_MAX >> 20)),
            Ok(Event::Start(start)) => element(Tag::Start(&start)),
            Ok(Event::Empty(start)) => {
                element(Tag::Start(&start)).and_then(|()| element(Tag::End(start.local_name().into_inner())))
            }
            Ok(Event::End(end)) => element(Tag::End(end.local_name().into_inner())),
            Ok(Event::Eof) => {
                drop(reader);
                archive.left = left;
                return Ok(());
            }
            Ok(_) => Ok(()),
            Err(e) => Err(e.to_string()),
        };
        done.map_err(|e| {
            format!("the 3MF's part {}, byte {}: {e}", shown(name.as_bytes()), reader.buffer_position())
        })?;
    }
}

enum Tag<'a> {
    Start(&'a BytesStart<'a>),
    End(&'a str),
}

/// The value of the attribute `name`, whatever its namespace's prefix.
fn attribute<'a>(start: &'a BytesStart<'_>, name: &str) -> Result<Option<std::borrow::Cow<'a, str>>, String> {
    for attribute in start.attributes().with_checks(false) {
        let attribute = attribute.map_err(|e| e.to_string())?;
        if attribute.key.local_name().into_inner() == name {
            return Ok(Some(attribute.value));
        }
    }
    Ok(None)
}

fn whole(start: &BytesStart<'_>, name: &str) -> Result<u32, String> {
    let value = attribute(start, name)?.unwrap_or_default();
    value.trim().parse().map_err(|_| {
        format!(
            "'{name}' of a {} is \"{}\"; a whole number was expected",
            shown(start.name().into_inner().as_bytes()),
            shown(value.as_bytes())
        )
    })
}

/// The part that holds the build.
fn root_model(archive: &mut Archive<'_>) -> Result<String, String> {
    let mut root = None;
    if archive.zip.index_for_name("_rels/.rels").is_some() {
        walk(archive, "_rels/.rels", |tag| {
            let Tag::Start(start) = tag else { return Ok(()) };
            if attribute(start, "Type")?.is_some_and(|t| t.ends_with("/3dmodel")) {
                root = attribute(start, "Target")?.map(|target| part_name(&target));
            }
            Ok(())
        })?;
    }
    Ok(root.unwrap_or_else(|| "3D/3dmodel.model".to_owned()))
}

/// A package path as the ZIP names it.
fn part_name(path: &str) -> String {
    path.trim_start_matches('/').to_owned()
}

impl Model {
    fn read(archive: &mut Archive<'_>, part: &str, limits: &Limits) -> Result<Self, String> {
        let mut model = Self { unit: 1e-3, objects: BTreeMap::new(), items: Vec::new() };
        let mut open: Option<(u32, Object)> = None;
        let mut in_mesh = false;
        let (mut triangles, mut vertices) = (0, 0);
        walk(archive, part, |tag| {
            match tag {
                Tag::Start(start) => match (start.local_name().into_inner(), &mut open) {
                    ("model", _) => model.unit = unit(start)?,
                    ("object", _) if model.objects.len() < OBJECTS_MAX => {
                        open = Some((whole(start, "id")?, Object::default()));
                    }
                    ("object", _) => return Err(format!("there are more than {OBJECTS_MAX} objects")),
                    ("mesh", Some(_)) => in_mesh = true,
                    ("vertex", Some((_, object))) if in_mesh => {
                        object.mesh.vertices.push(vertex(start)?);
                        vertices += 1;
                        limits.check_vertices(vertices, "3MF")?;
                    }
                    ("triangle", Some((_, object))) if in_mesh => {
                        object.mesh.triangles.push(triangle(start, object.mesh.vertices.len())?);
                        triangles += 1;
                        limits.check_triangles(triangles, "3MF")?;
                    }
                    ("component", Some((_, object))) if object.components.len() < PLACED_MAX => {
                        object.components.push(placed(start)?);
                    }
                    ("item", None) if model.items.len() < PLACED_MAX => model.items.push(placed(start)?),
                    ("component", Some(_)) | ("item", None) => {
                        return Err(format!("more than {PLACED_MAX} objects are placed"));
                    }
                    _ => {}
                },
                Tag::End("mesh") => in_mesh = false,
                Tag::End("object") => model.objects.extend(open.take()),
                Tag::End(_) => {}
            }
            Ok(())
        })?;
        Ok(model)
    }
}

fn unit(start: &BytesStart<'_>) -> Result<f64, String> {
    Ok(match attribute(start, "unit")?.as_deref() {
        Some("micron") => 1e-6,
        None | Some("millimeter") => 1e-3,
        Some("centimeter") => 1e-2,
        Some("inch") => 0.0254,
        Some("foot") => 0.3048,
        Some("meter") => 1.0,
        Some(other) => return Err(format!("the unit \"{}\" is unknown", shown(other.as_bytes()))),
    })
}

fn vertex(start: &BytesStart<'_>) -> Result<Point3<f64>, String> {
    let mut point = [f64::NAN; 3];
    for attribute in start.attributes().with_checks(false) {
        let attribute = attribute.map_err(|e| e.to_string())?;
        let axis = match attribute.key.into_inner() {
            "x" => 0,
            "y" => 1,
            "z" => 2,
            _ => continue,
        };
        point[axis] = attribute.value.trim().parse().unwrap_or(f64::NAN);
    }
    if point.iter().all(|x| x.is_finite()) {
        return Ok(Point3::from(point));
    }
    Err("a vertex has not the attributes x, y and z, a finite number each".to_owned())
}

fn triangle(start: &BytesStart<'_>, vertices: usize) -> Result<[u32; 3], String> {
    let mut corners = [None; 3];
    for attribute in start.attributes().with_checks(false) {
        let attribute = attribute.map_err(|e| e.to_string())?;
        let corner = match attribute.key.into_inner() {
            "v1" => 0,
            "v2" => 1,
            "v3" => 2,
            _ => continue,
        };
        corners[corner] = attribute.value.trim().parse::<u32>().ok().filter(|v| (*v as usize) < vertices);
    }
    match corners {
        [Some(a), Some(b), Some(c)] => Ok([a, b, c]),
        _ => Err(format!(
            "a triangle has not the attributes v1, v2 and v3, one of the {vertices} vertices before it, counted from 0, each"
        )),
    }
}

fn placed(start: &BytesStart<'_>) -> Result<Placed, String> {
    let transform = match attribute(start, "transform")? {
        None => Transform::default(),
        Some(text) => Transform::parse(&text).ok_or_else(|| {
            format!("the transform \"{}\" is not twelve finite numbers", shown(text.as_bytes()))
        })?,
    };
    Ok(Placed {
        object: whole(start, "objectid")?,
        part: attribute(start, "path")?.map(|p| part_name(&p)),
        transform,
    })
}

#[cfg(test)]
pub(crate) mod tests {
    use std::io::Write;

    use zip::write::SimpleFileOptions;

    use super::*;

    const LIMITS: Limits = Limits { triangles: 8, points: 5 };

    pub fn package(parts: &[(&str, &str)]) -> Vec<u8> {
        let mut zip = zip::ZipWriter::new(Cursor::new(Vec::new()));
        for (name, text) in parts {
            let options = SimpleFileOptions::default().compression_method(zip::CompressionMethod::Stored);
            zip.start_file(*name, options).unwrap();
            zip.write_all(text.as_bytes()).unwrap();
        }
        zip.finish().unwrap().into_inner()
    }

    const RELS: &str = r#"<Relationships xmlns="r"><Relationship Target="/3D/part.model" Id="a"
        Type="http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel"/></Relationships>"#;
    const OBJECT: &str = r#"<object id="1" type="model"><mesh><vertices><vertex x="0" y="0" z="0"/><vertex x="1" y="0" z="0.5"/>
        <vertex x="0" y="1" z="0"/></vertices><triangles><triangle v1="0" v2="1" v3="2"/></triangles></mesh></object>"#;

    pub fn model(objects: &str, items: &str) -> String {
        format!(
            "<?xml version=\"1.0\" encoding=\"UTF-8\"?><model unit=\"inch\" xmlns=\"m\" xmlns:p=\"p\"><metadata name=\"a\">b</metadata>\
             <resources>{objects}</resources><build>{items}</build></model>"
        )
    }

    fn read(objects: &str, items: &str) -> Result<(RawMesh, f64), String> {
        parse(&package(&[("_rels/.rels", RELS), ("3D/part.model", &model(objects, items))]), &LIMITS)
    }

    #[test]
    fn items_and_components_are_placed() {
        let assembly = r#"<object id="2"><components><component objectid="1" transform="0 1 0 -1 0 0 0 0 1 10 20 30"/>
            <component objectid="1"/></components></object><object id="3"/>"#;
        let items = r#"<item objectid="2" transform="1 0 0 0 1 0 0 0 1 100 0 0"/><item objectid="1"/>"#;
        let (mesh, unit) = read(&format!("{OBJECT}{assembly}"), items).unwrap();
        assert_eq!(unit, 0.0254);
        assert_eq!(mesh.triangles, [[0, 1, 2], [3, 4, 5], [6, 7, 8]]);
        // x goes to y: the images of the axes stand in the rows.
        assert_eq!(mesh.vertices[1], Point3::new(110.0, 21.0, 30.5));
        assert_eq!(mesh.vertices[4], Point3::new(101.0, 0.0, 0.5));
        assert_eq!(mesh.vertices[7], Point3::new(1.0, 0.0, 0.5));
    }

    #[test]
    fn objects_of_other_parts_are_found() {
        let items = r#"<item objectid="1" p:path="/3D/other.model"/>"#;
        let parts = [("3D/3dmodel.model", model("", items)), ("3D/other.model", model(OBJECT, ""))];
        let (mesh, _) = parse(&package(&parts.each_ref().map(|(n, t)| (*n, t.as_str()))), &LIMITS).unwrap();
        assert_eq!(mesh.triangles.len(), 1);
    }

    #[test]
    fn each_bad_file_is_one_clear_error() {
        let item = r#"<item objectid="1"/>"#;
        let object = |from: &str, to: &str| read(&OBJECT.replacen(from, to, 1), item).unwrap_err();
        let knot = r#"<object id="1"><components><component objectid="1"/></components></object>"#;
        let wide = format!(
            r#"<object id="2"><components>{}</components></object>"#,
            r#"<component objectid="3"/>"#.repeat(150)
        );
        let wide = format!(
            "{wide}{}<object id=\"4\"/>",
            wide.replace("\"3\"", "\"4\"").replace("id=\"2\"", "id=\"3\"")
        );
        for (error, part) in [
            (parse(b"", &LIMITS).unwrap_err(), "no valid ZIP"),
            (parse(&package(&[("a", "b")]), &LIMITS).unwrap_err(), "the 3MF's part 3D/3dmodel.model:"),
            (read("", "").unwrap_err(), "no triangles in the 0 items"),
            (read("", item).unwrap_err(), "places object 1, which 3D/part.model has not"),
            (read(OBJECT, &item.repeat(9)).unwrap_err(), "9 facets, more than the 8 allowed (max_triangles)"),
            (read(knot, item).unwrap_err(), "more than 16 deep"),
            (read(&wide, r#"<item objectid="2"/>"#).unwrap_err(), "more than 10000 objects"),
            (
                read(OBJECT, r#"<item objectid="1" transform="1 0 0"/>"#).unwrap_err(),
                "\"1 0 0\" is not twelve",
            ),
            (read(OBJECT, "<item/>").unwrap_err(), "'objectid' of a item is \"\""),
            (object("v3=\"2\"", "v3=\"3\""), "one of the 3 vertices before it"),
            (object("x=\"1\"", "x=\"nan\""), "the attributes x, y and z"),
            (object("</mesh>", "</mush>"), "the 3MF's part 3D/part.model, byte"),
            (read(OBJECT, "</x>").unwrap_err(), "byte"),
        ] {
            assert!(error.contains(part), "{part}: {error}");
        }
        let whole = package(&[("3D/3dmodel.model", &model(OBJECT, item))]);
        for cut in 1..whole.len() {
            assert!(parse(&whole[..cut], &LIMITS).is_err());
        }
    }

    /// Packages of some kilobytes that unpack to any amount.
    #[test]
    fn what_fills_the_memory_is_refused() {
        let packed = |text: &str| {
            let mut zip = zip::ZipWriter::new(Cursor::new(Vec::new()));
            zip.start_file("3D/3dmodel.model", SimpleFileOptions::default()).unwrap();
            zip.write_all(text.as_bytes()).unwrap();
            parse(&zip.finish().unwrap().into_inner(), &LIMITS).unwrap_err()
        };
        let blank = " ".repeat((CONTENT_FREE * 2) as usize);
        let error = packed(&model(&blank, ""));
        assert!(error.contains("a tag or text is larger than 16 MiB"), "{error}");
        let error = packed(&model(&"<a/> ".repeat((CONTENT_FREE * 2 / 5) as usize), ""));
        assert!(error.contains("bytes unpacked; at most 512 MiB, and 100 for each"), "{error}");
        let objects: String = (0..=OBJECTS_MAX).map(|id| format!("<object id=\"{id}\"/>")).collect();
        assert!(read(&objects, "").unwrap_err().contains("more than 100000 objects"));
        let vertices = r#"<vertex x="0" y="0" z="0"/>"#.repeat(20);
        let objects = format!(
            "<object id=\"1\"><mesh>{vertices}</mesh></object><object id=\"2\"><mesh>{vertices}</mesh></object>"
        );
        assert!(read(&objects, "").unwrap_err().contains("25 vertices, more than the 24 allowed"));
    }
}
