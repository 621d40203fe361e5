//! The chart of a flight, as SVG: triangles, misses and frame time over the frames, one under the other.

use anyhow::{Context, Result, anyhow};
use plotters::prelude::*;

/// Size of the picture, in pixels.
const SIZE: (u32, u32) = (960, 720);

/// One curve of the chart, and the label of its axis.
struct Panel {
    label: &'static str,
    column: &'static str,
    colour: RGBColor,
}

const PANELS: [Panel; 3] = [
    Panel { label: "triangles", column: "triangles", colour: RGBColor(31, 119, 180) },
    Panel { label: "misses", column: "misses", colour: RGBColor(214, 39, 40) },
    Panel { label: "frame time, ms", column: "frame_ms", colour: RGBColor(44, 160, 44) },
];

/// Draws the chart of the per-frame figures that `vdt navigate --csv` writes.
pub fn flight_chart(csv: &str, title: &str) -> Result<String> {
    let mut svg = String::new();
    {
        let area = SVGBackend::with_string(&mut svg, SIZE).into_drawing_area();
        area.fill(&WHITE).map_err(drawing)?;
        let area = area.titled(title, ("sans-serif", 20)).map_err(drawing)?;
        for (panel, area) in PANELS.iter().zip(area.split_evenly((PANELS.len(), 1))) {
            draw_panel(panel, &column(csv, panel.column)?, &area)?;
        }
        area.present().map_err(drawing)?;
    }
    Ok(svg)
}

type Area<'a> = DrawingArea<SVGBackend<'a>, plotters::coord::Shift>;

fn draw_panel(panel: &Panel, values: &[f64], area: &Area<'_>) -> Result<()> {
    let highest = values.iter().copied().fold(0.0, f64::max);
    let frames = values.len().max(2) - 1;
    let mut chart = ChartBuilder::on(area)
        .margin(8)
        .x_label_area_size(28)
        .y_label_area_size(72)
        .build_cartesian_2d(0..frames, 0.0..if highest > 0.0 { highest * 1.05 } else { 1.0 })
        .map_err(drawing)?;
    chart
        .configure_mesh()
        .disable_x_mesh()
        .x_desc("frame")
        .y_desc(panel.label)
        .y_label_formatter(&|value| axis_label(*value))
        .draw()
        .map_err(drawing)?;
    chart.draw_series(LineSeries::new(values.iter().copied().enumerate(), &panel.colour)).map_err(drawing)?;
    Ok(())
}

fn axis_label(value: f64) -> String {
    if value >= 1000.0 { format!("{:.0}k", value / 1000.0) } else { format!("{value}") }
}

fn drawing(error: impl std::fmt::Display) -> anyhow::Error {
    anyhow!("the chart cannot be drawn: {error}")
}

/// The numbers of one column of a CSV text with a header line.
fn column(csv: &str, name: &str) -> Result<Vec<f64>> {
    let mut lines = csv.lines();
    let header = lines.next().unwrap_or_default();
    let place = header.split(',').position(|field| field == name);
    let place = place.with_context(|| format!("the flight's figures have no column {name}"))?;
    lines
        .map(|line| {
            let field = line.split(',').nth(place).unwrap_or_default();
            field.trim().parse().with_context(|| format!("`{field}` in column {name} is not a number"))
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_chart_has_a_curve_for_each_figure() {
        let csv = "frame,triangles,misses,frame_ms\n0,1000,0,1.5\n1,2000,3,2.5\n2,1500,0,0.5\n";
        assert_eq!(column(csv, "frame_ms").unwrap(), [1.5, 2.5, 0.5]);
        let svg = flight_chart(csv, "a flight").unwrap();
        assert!(svg.starts_with("<svg") && svg.trim_end().ends_with("</svg>"));
        assert_eq!(svg.matches("<polyline fill=\"none\"").count(), svg.matches("<polyline").count());
        for word in ["a flight", "triangles", "misses", "frame time, ms"] {
            assert!(svg.contains(word), "{word}");
        }
        assert!(column(csv, "reads").is_err());
    }

    #[test]
    fn a_flight_of_one_frame_or_none_has_a_chart_too() {
        for csv in ["frame,triangles,misses,frame_ms\n", "frame,triangles,misses,frame_ms\n0,0,0,0\n"] {
            assert!(flight_chart(csv, "short").unwrap().starts_with("<svg"));
        }
    }
}
