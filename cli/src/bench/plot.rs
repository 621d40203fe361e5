//! The pictures of the benches, as SVG: bytes moved against memory, CPU time for each triangle, stated errors against
//! measured ones, bytes that a flight reads against the size of place holders, and times of frames against memory.

use std::ops::Range;

use anyhow::{Result, anyhow};
use metanode::header::Blocking;
use plotters::coord::CoordTranslate;
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};
use storage::ByteSize;

use super::blocking;
use super::cuts::Kind;
use super::error;
use super::figures::{Figures, PHASES};
use super::io::{Outcome, Point};
use super::strategy::StrategyChoice;
use super::table1::Row;
use crate::output::grouped;

/// Colours of lines and of parts of bars, in order.
const COLOURS: [RGBColor; 5] = [
    RGBColor(31, 119, 180),
    RGBColor(214, 39, 40),
    RGBColor(44, 160, 44),
    RGBColor(148, 103, 189),
    RGBColor(255, 127, 14),
];
const FONT: &str = "sans-serif";
/// Width of a picture, in pixels.
const WIDTH: u32 = 960;
/// Height of the picture of bytes moved, in pixels.
const HEIGHT: u32 = 600;
/// Height of a title over several charts, in pixels.
const CAPTION: u32 = 40;
/// Characters of a name beside a bar, at most.
const NAME: usize = 22;
/// Height of one bar with the room around it, in pixels.
const BAR: u32 = 44;
/// Height of what is around all bars, and of the room that the list of colours takes where there are few, in pixels.
const AROUND_BARS: u32 = 180;

fn colour(number: usize) -> RGBColor {
    COLOURS[number % COLOURS.len()]
}

fn drawing(error: impl std::fmt::Display) -> anyhow::Error {
    anyhow!("the picture cannot be drawn: {error}")
}

/// Draws, for each strategy, the bytes read and written for each triangle against the memory limit; both on logarithmic
/// scales. A cross at the bottom is a limit that the strategy refuses.
pub fn bytes_against_memory(strategies: &[StrategyChoice], points: &[Point], title: &str) -> Result<String> {
    let mut svg = String::new();
    {
        let area = SVGBackend::with_string(&mut svg, (WIDTH, HEIGHT)).into_drawing_area();
        area.fill(&WHITE).map_err(drawing)?;
        let (memory, bytes) = ranges(points);
        let floor = bytes.start;
        let mut limits: Vec<f64> = points.iter().map(|point| point.limit.0 as f64).collect();
        limits.sort_by(f64::total_cmp);
        limits.dedup();
        let mut chart = ChartBuilder::on(&area)
            .caption(title, (FONT, 20))
            .margin(16)
            .x_label_area_size(48)
            .y_label_area_size(80)
            .build_cartesian_2d(memory.log_scale().base(2.0).with_key_points(limits), bytes.log_scale())
            .map_err(drawing)?;
        chart
            .configure_mesh()
            .x_desc("memory limit")
            .y_desc("bytes read and written for each triangle")
            .x_label_formatter(&|bytes| ByteSize(*bytes as u64).to_string())
            .y_label_formatter(&|bytes| grouped(bytes.round() as u64))
            .label_style((FONT, 15))
            .draw()
            .map_err(drawing)?;
        // Points whose bytes are written at them: once, where several are as good as the same.
        let mut labelled: Vec<(f64, f64)> = Vec::new();
        for (number, strategy) in strategies.iter().enumerate() {
            let colour = colour(number);
            let own = || points.iter().filter(|point| point.strategy == *strategy);
            let mut line: Vec<(f64, f64)> =
                own().filter_map(|point| Some((point.limit.0 as f64, point.bytes_per_triangle()?))).collect();
            line.sort_by(|left, right| left.0.total_cmp(&right.0));
            let dots = line.clone();
            // Where curves lie on each other, the lower ones are seen at the edges of the upper ones.
            let above = (strategies.len() - 1 - number) as u32;
            chart
                .draw_series(LineSeries::new(line, colour.stroke_width(2 + 3 * above)))
                .map_err(drawing)?
                .label(strategy.to_string())
                .legend(move |(x, y)| PathElement::new([(x, y), (x + 24, y)], colour.stroke_width(2)));
            let radius = 4 + 2 * above;
            chart.draw_series(dots.iter().map(|at| Circle::new(*at, radius, colour.filled()))).map_err(drawing)?;
            let style = text_style(14, colour, HPos::Center, VPos::Bottom);
            let mut labels = Vec::new();
            for at in dots {
                let is_free = |other: &(f64, f64)| other.0 != at.0 || !(0.8..1.25).contains(&(other.1 / at.1));
                if labelled.iter().all(is_free) {
                    let text = Text::new(grouped(at.1.round() as u64), (0, -4 - radius as i32), style.clone());
                    labels.push(EmptyElement::at(at) + text);
                    labelled.push(at);
                }
            }
            chart.draw_series(labels).map_err(drawing)?;
            // Side by side, where several strategies refuse the same limit.
            let shift = 14 * (2 * number as i32 - strategies.len() as i32 + 1) / 2;
            let refused = own().filter(|point| !matches!(point.outcome, Outcome::Built(_)));
            let crosses = refused.map(|point| {
                EmptyElement::at((point.limit.0 as f64, floor)) + Cross::new((shift, -10), 6, colour.stroke_width(2))
            });
            chart.draw_series(crosses).map_err(drawing)?;
        }
        if points.iter().any(|point| !matches!(point.outcome, Outcome::Built(_))) {
            chart
                .draw_series(std::iter::empty::<Circle<(f64, f64), i32>>())
                .map_err(drawing)?
                .label("refused or failed")
                .legend(|(x, y)| Cross::new((x + 12, y), 6, BLACK.stroke_width(2)));
        }
        draw_legend(&mut chart, SeriesLabelPosition::UpperRight)?;
        area.present().map_err(drawing)?;
    }
    Ok(svg)
}

/// Says what the series are, over what is drawn.
fn draw_legend<'a, C: CoordTranslate>(
    chart: &mut ChartContext<'a, SVGBackend<'a>, C>,
    position: SeriesLabelPosition,
) -> Result<()> {
    let labels = &mut chart.configure_series_labels();
    let labels = labels.position(position).background_style(WHITE.mix(0.8)).border_style(BLACK.mix(0.3));
    labels.label_font((FONT, 15)).draw().map_err(drawing)
}

/// What the axes have to hold, with some room.
fn ranges(points: &[Point]) -> (Range<f64>, Range<f64>) {
    let limits = points.iter().map(|point| point.limit.0.max(1) as f64);
    let memory = limits.clone().fold(f64::INFINITY, f64::min)..limits.fold(1.0, f64::max);
    let moved = || points.iter().filter_map(Point::bytes_per_triangle).map(|bytes| bytes.max(1.0));
    let (least, most) = (moved().fold(f64::INFINITY, f64::min), moved().fold(0.0, f64::max));
    let bytes = if most > 0.0 { least / 2.0..most * 2.0 } else { 1.0..1000.0 };
    (memory.start / 1.3..memory.end * 1.3, bytes)
}

fn text_style(size: i32, colour: RGBColor, horizontal: HPos, vertical: VPos) -> TextStyle<'static> {
    let style = TextStyle::from((FONT, size).into_font()).pos(Pos::new(horizontal, vertical));
    TextStyle { color: colour.to_backend_color(), ..style }
}

/// Draws a bar for each mesh: the CPU time of its build for each triangle of the input, in its phases.
pub fn times_per_triangle(rows: &[Row], title: &str) -> Result<String> {
    let bars: Vec<(&str, Option<Vec<f64>>)> = rows
        .iter()
        .map(|row| (row.name.as_str(), row.outcome.as_ref().ok().and_then(|built| parts(&built.figures))))
        .collect();
    let longest =
        bars.iter().filter_map(|(_, parts)| parts.as_ref()).map(|parts| parts.iter().sum()).fold(0.0, f64::max);
    let most = if longest > 0.0 { longest * 1.35 } else { 1.0 };
    let mut svg = String::new();
    {
        let height = AROUND_BARS + BAR * rows.len().max(1) as u32;
        let area = SVGBackend::with_string(&mut svg, (WIDTH, height)).into_drawing_area();
        area.fill(&WHITE).map_err(drawing)?;
        let mut chart = ChartBuilder::on(&area)
            .caption(title, (FONT, 18))
            .margin(16)
            .x_label_area_size(44)
            .y_label_area_size(190)
            .build_cartesian_2d(0.0..most, 0.0..rows.len().max(1) as f64)
            .map_err(drawing)?;
        chart
            .configure_mesh()
            .disable_y_mesh()
            .disable_y_axis()
            .x_desc("microseconds of CPU time for each triangle of the input")
            .label_style((FONT, 15))
            .draw()
            .map_err(drawing)?;
        for (phase, name) in PHASES.iter().enumerate() {
            let colour = colour(phase);
            let boxes = bars.iter().enumerate().filter_map(|(number, (_, parts))| {
                let parts = parts.as_ref()?;
                let start: f64 = parts[..phase].iter().sum();
                let top = (rows.len() - number) as f64;
                Some(Rectangle::new([(start, top - 0.2), (start + parts[phase], top - 0.8)], colour.filled()))
            });
            chart
                .draw_series(boxes)
                .map_err(drawing)?
                .label(*name)
                .legend(move |(x, y)| Rectangle::new([(x, y - 6), (x + 16, y + 6)], colour.filled()));
        }
        let names = bars.iter().enumerate().map(|(number, (name, _))| {
            let style = text_style(15, BLACK, HPos::Right, VPos::Center);
            EmptyElement::at((0.0, (rows.len() - number) as f64 - 0.5)) + Text::new(shortened(name), (-8, 0), style)
        });
        chart.draw_series(names).map_err(drawing)?;
        let sums = bars.iter().enumerate().map(|(number, (_, parts))| {
            let sum: f64 = parts.iter().flatten().sum();
            let text = match (&rows[number].outcome, parts) {
                (Err(_), _) => "failed".to_owned(),
                (Ok(_), None) => "unknown".to_owned(),
                (Ok(_), Some(_)) => format!("{sum:.2}"),
            };
            let style = text_style(15, BLACK, HPos::Left, VPos::Center);
            EmptyElement::at((sum, (rows.len() - number) as f64 - 0.5)) + Text::new(text, (8, 0), style)
        });
        chart.draw_series(sums).map_err(drawing)?;
        draw_legend(&mut chart, SeriesLabelPosition::LowerRight)?;
        area.present().map_err(drawing)?;
    }
    Ok(svg)
}

/// Draws, for each cut, what is stated of its error for each unit of what is measured, against its triangles; both on
/// logarithmic scales. Below the line at 1 the statement is wrong.
pub fn ratios(rows: &[error::Row], title: &str) -> Result<String> {
    let points = |kind| {
        let own = rows.iter().filter(move |row: &&error::Row| row.kind == kind);
        own.filter_map(|row| Some((row.triangles as f64, row.ratio()?)))
    };
    let all = || Kind::ALL.into_iter().flat_map(points);
    let (fewest, most) = (all().map(|at| at.0).fold(1e12, f64::min), all().map(|at| at.0).fold(1.0, f64::max));
    let (least, largest) = (all().map(|at| at.1).fold(1.0, f64::min), all().map(|at| at.1).fold(1.0, f64::max));
    let triangles = fewest.min(most) / 1.3..most * 1.3;
    let mut svg = String::new();
    {
        let area = SVGBackend::with_string(&mut svg, (WIDTH, HEIGHT)).into_drawing_area();
        area.fill(&WHITE).map_err(drawing)?;
        let mut chart = ChartBuilder::on(&area)
            .caption(title, (FONT, 20))
            .margin(16)
            .x_label_area_size(48)
            .y_label_area_size(80)
            .build_cartesian_2d(triangles.clone().log_scale(), (least / 2.0..largest * 2.0).log_scale())
            .map_err(drawing)?;
        chart
            .configure_mesh()
            .x_desc("triangles of the cut")
            .y_desc("stated error for each unit measured")
            .x_label_formatter(&|triangles| grouped(triangles.round() as u64))
            .label_style((FONT, 15))
            .draw()
            .map_err(drawing)?;
        let line = [(triangles.start, 1.0), (triangles.end, 1.0)];
        chart.draw_series(LineSeries::new(line, BLACK.stroke_width(2))).map_err(drawing)?;
        for (number, kind) in Kind::ALL.into_iter().enumerate() {
            let colour = colour(number);
            chart
                .draw_series(points(kind).map(|at| Circle::new(at, 5, colour.filled())))
                .map_err(drawing)?
                .label(kind.name())
                .legend(move |(x, y)| Circle::new((x + 12, y), 5, colour.filled()));
        }
        draw_legend(&mut chart, SeriesLabelPosition::UpperRight)?;
        area.present().map_err(drawing)?;
    }
    Ok(svg)
}

/// Draws, for each mesh under the others, the bytes that a flight within the budget reads in a frame against the size of the
/// place holders, both on logarithmic scales: a line for each fan-out, and one for whole levels.
pub fn reads_against_slots(subjects: &[blocking::Subject], title: &str) -> Result<String> {
    let panels: Vec<Panel> = subjects
        .iter()
        .map(|subject| Panel {
            name: subject.name.clone(),
            axes: ["place holder", "read in a frame"],
            lines: reads_lines(subject),
            label: &|bytes| ByteSize(bytes as u64).to_string(),
        })
        .collect();
    draw_panels(&panels, title)
}

/// Draws, for each flight under the others, the time of a frame against the memory, both on logarithmic scales: a line
/// for each way to fly.
pub fn frame_times_against_memory(flights: Vec<(String, Vec<Line>)>, title: &str) -> Result<String> {
    let panels: Vec<Panel> = flights
        .into_iter()
        .map(|(name, lines)| Panel { name, axes: ["memory", "milliseconds"], lines, label: &|time| format!("{time}") })
        .collect();
    draw_panels(&panels, title)
}

/// A chart of several lines, both axes logarithmic, that on the bottom in bytes.
struct Panel {
    name: String,
    /// What is on the axes, that on the bottom first.
    axes: [&'static str; 2],
    lines: Vec<Line>,
    /// How values on the left are written.
    label: &'static dyn Fn(f64) -> String,
}

fn draw_panels(panels: &[Panel], title: &str) -> Result<String> {
    let mut svg = String::new();
    {
        let height = CAPTION + HEIGHT * panels.len().max(1) as u32;
        let area = SVGBackend::with_string(&mut svg, (WIDTH, height)).into_drawing_area();
        area.fill(&WHITE).map_err(drawing)?;
        let area = area.titled(title, (FONT, 20)).map_err(drawing)?;
        for (panel, area) in panels.iter().zip(area.split_evenly((panels.len().max(1), 1))) {
            draw_panel(panel, &area)?;
        }
        area.present().map_err(drawing)?;
    }
    Ok(svg)
}

/// A line of a picture: its name and its points, with x and y above 0.
pub type Line = (String, Vec<(f64, f64)>);

/// The lines of one mesh, in the order of its blockings.
fn reads_lines(subject: &blocking::Subject) -> Vec<Line> {
    let mut lines: Vec<Line> = Vec::new();
    for row in subject.outcome.iter().flatten() {
        let blocking::Outcome::Measured(measured) = &row.outcome else { continue };
        let name = match row.blocking {
            Blocking::Forest { fan_out, .. } => format!("forest, fan-out {fan_out}"),
            Blocking::Levels { .. } => "levels".to_owned(),
        };
        // On a logarithmic scale there is no zero.
        let at = (f64::from(measured.slot_bytes.max(1)), measured.budget.bytes_per_frame().max(1.0));
        match lines.iter_mut().find(|(other, _)| *other == name) {
            Some((_, points)) => points.push(at),
            None => lines.push((name, vec![at])),
        }
    }
    lines
}

fn draw_panel<'a>(panel: &Panel, area: &DrawingArea<SVGBackend<'a>, plotters::coord::Shift>) -> Result<()> {
    let Panel { name, axes, lines, label } = panel;
    let all = || lines.iter().flat_map(|(_, points)| points);
    let around = |values: &mut dyn Iterator<Item = f64>, by: f64| {
        let (least, most) = values.fold((f64::INFINITY, 0.0_f64), |(least, most), at| (least.min(at), most.max(at)));
        if most > 0.0 { least / by..most * by } else { 1.0..1024.0 }
    };
    let across = around(&mut all().map(|at| at.0), 1.3);
    let up = around(&mut all().map(|at| at.1), 1.5);
    let mut chart = ChartBuilder::on(area)
        .caption(name, (FONT, 18))
        .margin(16)
        .x_label_area_size(48)
        .y_label_area_size(90)
        .build_cartesian_2d(across.log_scale().base(2.0), up.log_scale().base(2.0))
        .map_err(drawing)?;
    chart
        .configure_mesh()
        .x_desc(axes[0])
        .y_desc(axes[1])
        .x_label_formatter(&|bytes| ByteSize(*bytes as u64).to_string())
        .y_label_formatter(&|value| label(*value))
        .label_style((FONT, 15))
        .draw()
        .map_err(drawing)?;
    for (number, (name, points)) in lines.iter().enumerate() {
        let colour = colour(number);
        let mut points = points.clone();
        points.sort_by(|left, right| left.0.total_cmp(&right.0));
        let dots: Vec<_> = points.iter().map(|at| Circle::new(*at, 4, colour.filled())).collect();
        chart
            .draw_series(LineSeries::new(points, colour.stroke_width(2)))
            .map_err(drawing)?
            .label(name.as_str())
            .legend(move |(x, y)| PathElement::new([(x, y), (x + 24, y)], colour.stroke_width(2)));
        chart.draw_series(dots).map_err(drawing)?;
    }
    draw_legend(&mut chart, SeriesLabelPosition::UpperRight)
}

/// A name that fits beside its bar.
fn shortened(name: &str) -> String {
    match name.char_indices().nth(NAME) {
        None => name.to_owned(),
        Some((end, _)) => format!("{}…", &name[..end]),
    }
}

/// Microseconds of CPU time of each phase for each triangle of the input.
fn parts(figures: &Figures) -> Option<Vec<f64>> {
    let triangles = figures.whole("input_triangles").filter(|triangles| *triangles > 0)? as f64;
    Some(figures.phases()?.iter().map(|phase| phase.cpu_seconds * 1e6 / triangles).collect())
}
