//! Pictures of a plan without a browser, as PNG or SVG. The font comes along: none is looked for on the machine.

use std::error::Error;
use std::sync::Once;

use nalgebra::Point3;
use patchmill_visualization::colours;
use plotters::coord::Shift;
use plotters::coord::types::RangedCoordf64;
use plotters::prelude::*;
use plotters::style::register_font;

use crate::map_colours::{RADIUS_LIMIT, Rgb, of_curvature, of_leftover, of_radius};
use crate::plan::Plan;
use crate::raster::Raster;
use crate::shown_surface::ShownSurface;

/// What a picture shows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum What {
    /// The patches from above.
    Patches,
    /// The rolling ball's radius.
    Radius,
    /// What the program leaves.
    Residual,
    /// The passes over the patches.
    Passes,
    /// The candidates' times.
    Time,
}

/// How a picture is written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    /// Pixels.
    Png,
    /// Shapes; coarser in colour where there are many.
    Svg,
}

/// Largest picture, pixels.
const MOST: [f64; 2] = [1200.0, 900.0];
/// Around the drawing, pixels: left, right, top, bottom.
const ROOM: [u32; 4] = [86, 116, 52, 58];
/// Of that, left and below free of everything.
const EDGE: u32 = 10;
/// Triangles of the drawn surface.
const TRIANGLES: usize = 60_000;
/// Pixels of a cell in an SVG picture, and shades of its colours: it has a shape a run of cells.
const SVG_CELL: f64 = 5.0;
const SVG_SHADES: f64 = 16.0;
const FONT: &[u8] = include_bytes!("../font/DejaVuSans-subset.ttf");
const FAMILY: &str = "sans-serif";

type Drawn = Result<(), Box<dyn Error>>;
type Area<'a, B> = DrawingArea<B, Shift>;
type Chart<'a, B> = ChartContext<'a, B, Cartesian2d<RangedCoordf64, RangedCoordf64>>;

/// A picture of a plan: the bytes of its file.
///
/// # Errors
/// With one sentence when the plan's products do not fit each other or nothing can be drawn.
pub fn picture(plan: &Plan, what: What, format: Format) -> Result<Vec<u8>, String> {
    static REGISTERED: Once = Once::new();
    REGISTERED.call_once(|| {
        // The font is this crate's own; if it could not be read every picture would say so.
        let _ = register_font(FAMILY, FontStyle::Normal, FONT);
    });
    let failed = |e: Box<dyn Error>| format!("the picture cannot be drawn: {e}");
    if what == What::Time {
        let size = [1000, 480];
        return match format {
            Format::Png => png(size, |root| times(&root, plan)).map_err(failed),
            Format::Svg => svg(size, |root| times(&root, plan)).map_err(failed),
        };
    }
    let scene = MapScene::of(plan, what, format)?;
    match format {
        Format::Png => png(scene.size, |root| scene.draw(&root)).map_err(failed),
        Format::Svg => svg(scene.size, |root| scene.draw(&root)).map_err(failed),
    }
}

fn png(
    size: [u32; 2],
    draw: impl FnOnce(DrawingArea<BitMapBackend<'_>, Shift>) -> Drawn,
) -> Result<Vec<u8>, Box<dyn Error>> {
    let [width, height] = size;
    let mut pixels = vec![0; width as usize * height as usize * 3];
    draw(BitMapBackend::with_buffer(&mut pixels, (width, height)).into_drawing_area())?;
    let mut file = Vec::new();
    let mut encoder = png::Encoder::new(&mut file, width, height);
    encoder.set_color(png::ColorType::Rgb);
    encoder.set_depth(png::BitDepth::Eight);
    encoder.set_compression(png::Compression::High);
    encoder.write_header()?.write_image_data(&pixels)?;
    Ok(file)
}

fn svg(
    size: [u32; 2],
    draw: impl FnOnce(DrawingArea<SVGBackend<'_>, Shift>) -> Drawn,
) -> Result<Vec<u8>, Box<dyn Error>> {
    let mut text = String::new();
    draw(SVGBackend::with_string(&mut text, (size[0], size[1])).into_drawing_area())?;
    Ok(text.into_bytes())
}

fn rgb(colour: [u8; 3]) -> RGBColor {
    RGBColor(colour[0], colour[1], colour[2])
}

fn bytes(colour: Rgb) -> RGBColor {
    rgb(colour.map(|c| (c * 255.0).round() as u8))
}

/// A map of the surface from above, x to the right, y upwards.
struct MapScene<'a> {
    plan: &'a Plan,
    what: What,
    surface: ShownSurface,
    size: [u32; 2],
    /// mm, of the axes.
    bounds: [Point3<f64>; 2],
    /// m.
    cell: f64,
    shades: Option<f64>,
}

impl<'a> MapScene<'a> {
    fn of(plan: &'a Plan, what: What, format: Format) -> Result<Self, String> {
        let surface = ShownSurface::of(plan, TRIANGLES)?;
        let [low, high] = surface.bounds();
        let (width, height) = (high.x - low.x, high.y - low.y);
        if !(width > 0.0 && height > 0.0) {
            return Err("the surface has no extent as seen from above: there is nothing to draw".to_owned());
        }
        let [left, right, top, bottom] = ROOM;
        let pixels =
            ((MOST[0] - f64::from(left + right)) / width).min((MOST[1] - f64::from(top + bottom)) / height);
        let across = |extent: f64| (extent * pixels).round().max(40.0) as u32;
        let (cell, shades) = match format {
            Format::Png => (1.0, None),
            Format::Svg => (SVG_CELL, Some(SVG_SHADES)),
        };
        Ok(Self {
            plan,
            what,
            size: [across(width) + left + right, across(height) + top + bottom],
            bounds: [low * 1e3, high * 1e3],
            cell: cell / pixels,
            shades,
            surface,
        })
    }

    fn draw<B: DrawingBackend>(&self, root: &Area<'_, B>) -> Drawn
    where
        B::ErrorType: 'static,
    {
        root.fill(&WHITE)?;
        let [left, right, top, bottom] = ROOM;
        let [low, high] = self.bounds;
        let mut chart = ChartBuilder::on(root)
            .margin_right(right)
            .margin_top(top)
            .margin_left(EDGE)
            .margin_bottom(EDGE)
            .x_label_area_size(bottom - EDGE)
            .y_label_area_size(left - EDGE)
            .build_cartesian_2d(low.x..high.x, low.y..high.y)?;
        chart
            .configure_mesh()
            .disable_mesh()
            .x_desc("x, mm")
            .y_desc("y, mm")
            .x_label_formatter(&|v| format!("{v:.0}"))
            .y_label_formatter(&|v| format!("{v:.0}"))
            .label_style((FAMILY, 15))
            .axis_desc_style((FAMILY, 16))
            .draw()?;
        self.cells(&mut chart)?;
        if self.what == What::Passes {
            self.passes(&mut chart)?;
        }
        let style = TextStyle::from((FAMILY, 20));
        root.draw_text(&self.title(), &style, (left as i32, 16))?;
        self.key(root)
    }

    fn title(&self) -> String {
        let file = self.plan.surface.rsplit(['/', '\\']).next().unwrap_or_default();
        let what = match self.what {
            What::Patches => format!(
                "{} patches, {:.1} s",
                self.plan.program.patches.len(),
                self.plan.program.machining_time
            ),
            What::Radius => "rolling-ball radius".to_owned(),
            What::Residual => {
                format!("left by the program, at most {:.4} mm", self.plan.program.proof.scallop_max * 1e3)
            }
            What::Passes | What::Time => format!("passes, {:.0} mm cut", self.plan.program.cut_length * 1e3),
        };
        format!("{file}: {what}")
    }

    fn cells<B: DrawingBackend>(&self, chart: &mut Chart<'_, B>) -> Drawn
    where
        B::ErrorType: 'static,
    {
        let raster = Raster::of(&self.surface, self.cell, |t, weights| self.colour(t, weights));
        let size = self.cell * 1e3;
        let [low, high] = self.bounds;
        chart.draw_series(raster.runs().into_iter().map(|run| {
            let x = |cell: usize| (low.x + cell as f64 * size).min(high.x);
            let y = |row: usize| (high.y - row as f64 * size).max(low.y);
            Rectangle::new([(x(run.from), y(run.row)), (x(run.to), y(run.row + 1))], rgb(run.colour).filled())
        }))?;
        Ok(())
    }

    fn colour(&self, triangle: usize, weights: [f64; 3]) -> Rgb {
        let corners = self.surface.triangles[triangle].map(|v| v as usize);
        let colour = match self.what {
            What::Radius => {
                of_curvature(weights.iter().zip(corners).map(|(w, v)| w * self.surface.curvature[v]).sum())
            }
            What::Residual => {
                let job = &self.plan.job;
                let left: Option<f64> =
                    weights.iter().zip(corners).map(|(w, v)| Some(w * self.surface.leftover[v]?)).sum();
                left.map_or([0.5; 3], |left| of_leftover(left, job.scallop_height, job.gouge_tolerance))
            }
            _ => return colours::patch(self.surface.patches[triangle] as usize).map(f64::from),
        };
        // Few shades make long runs.
        self.shades.map_or(colour, |n| colour.map(|c| (c * n).round() / n))
    }

    fn passes<B: DrawingBackend>(&self, chart: &mut Chart<'_, B>) -> Drawn
    where
        B::ErrorType: 'static,
    {
        for patch in &self.plan.toolpath.patches {
            let colour = bytes(colours::passes(patch.patch as usize).map(f64::from));
            for pass in &patch.passes {
                let line: Vec<_> = pass.cc.iter().map(|p| (p.x * 1e3, p.y * 1e3)).collect();
                chart.draw_series([PathElement::new(line, colour.stroke_width(1))])?;
            }
        }
        Ok(())
    }

    /// The colours' meaning, right of the map.
    fn key<B: DrawingBackend>(&self, root: &Area<'_, B>) -> Drawn
    where
        B::ErrorType: 'static,
    {
        let left = (self.size[0] - ROOM[1] + 18) as i32;
        let (top, bottom) = (ROOM[2] as i32, (self.size[1] - ROOM[3]) as i32);
        let style = TextStyle::from((FAMILY, 15));
        let text = |text: String, y: i32| root.draw_text(&text, &style, (left + 26, y - 7));
        let job = &self.plan.job;
        let (colour, labels): (Box<dyn Fn(f64) -> Rgb>, [String; 3]) = match self.what {
            What::Radius => {
                let end = RADIUS_LIMIT * 1e3;
                (
                    Box::new(|t| of_radius(t * RADIUS_LIMIT)),
                    [format!("\u{2265} {end:.0}"), "0 mm".to_owned(), format!("\u{2264} \u{2212}{end:.0}")],
                )
            }
            What::Residual => {
                let (h, g) = (job.scallop_height, job.gouge_tolerance);
                let of = move |t: f64| of_leftover(t * if t > 0.0 { h } else { g }, h, g);
                (
                    Box::new(of),
                    [format!("{:.4}", h * 1e3), "0 mm".to_owned(), format!("\u{2212}{:.4}", g * 1e3)],
                )
            }
            _ => {
                for (i, patch) in self.plan.program.patches.iter().enumerate() {
                    let y = top + 8 + 24 * i as i32;
                    let fill = bytes(colours::patch(patch.plan.patch as usize).map(f64::from)).filled();
                    root.draw(&Rectangle::new([(left, y - 7), (left + 16, y + 9)], fill))?;
                    text(format!("{}", i + 1), y)?;
                }
                return Ok(());
            }
        };
        for y in top..bottom {
            let t = 1.0 - 2.0 * f64::from(y - top) / f64::from(bottom - top - 1);
            root.draw(&Rectangle::new([(left, y), (left + 16, y + 1)], bytes(colour(t)).filled()))?;
        }
        for (label, y) in labels.into_iter().zip([top + 6, (top + bottom) / 2, bottom - 8]) {
            text(label, y)?;
        }
        Ok(())
    }
}

/// The candidates' times as bars.
fn times<B: DrawingBackend>(root: &Area<'_, B>, plan: &Plan) -> Drawn
where
    B::ErrorType: 'static,
{
    root.fill(&WHITE)?;
    let all = &plan.evaluation.candidates;
    let longest = all.iter().map(|c| c.machining_time).fold(1.0, f64::max);
    let (first, last) = (
        all.iter().map(|c| c.patch_count).min().unwrap_or(1),
        all.iter().map(|c| c.patch_count).max().unwrap_or(1),
    );
    let file = plan.surface.rsplit(['/', '\\']).next().unwrap_or_default();
    let mut chart = ChartBuilder::on(root)
        .margin(14)
        .caption(format!("{file}: machining time by number of patches"), (FAMILY, 20))
        .x_label_area_size(50)
        .y_label_area_size(64)
        .build_cartesian_2d(f64::from(first) - 0.6..f64::from(last) + 0.6, 0.0..longest * 1.12)?;
    chart
        .configure_mesh()
        .disable_x_mesh()
        .light_line_style(TRANSPARENT)
        .bold_line_style(BLACK.mix(0.15))
        .y_label_formatter(&|v| format!("{v:.0}"))
        .x_labels((last - first + 2) as usize)
        .x_label_formatter(&|x| if (x - x.round()).abs() < 1e-6 { format!("{x:.0}") } else { String::new() })
        .x_desc("patches")
        .y_desc("time, s")
        .label_style((FAMILY, 15))
        .axis_desc_style((FAMILY, 16))
        .draw()?;
    let centred = TextStyle::from((FAMILY, 15)).pos(plotters::style::text_anchor::Pos::new(
        plotters::style::text_anchor::HPos::Center,
        plotters::style::text_anchor::VPos::Bottom,
    ));
    for candidate in all {
        let x = f64::from(candidate.patch_count);
        let colour = if plan.evaluation.chosen == Some(candidate.index) {
            RGBColor(11, 98, 196)
        } else {
            RGBColor(157, 192, 231)
        };
        let (height, label) = if candidate.feasible {
            (candidate.machining_time, format!("{:.1}", candidate.machining_time))
        } else {
            (0.0, "not possible".to_owned())
        };
        chart.draw_series([Rectangle::new([(x - 0.36, 0.0), (x + 0.36, height)], colour.filled())])?;
        chart.draw_series([Text::new(label, (x, height + longest * 0.012), centred.clone())])?;
    }
    Ok(())
}
