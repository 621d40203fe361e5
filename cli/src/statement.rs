//! What is said of a surface's distance from the input, in words and for programs.

use metanode::Statement;
use metanode::header::{ErrorBound, Header};
use serde_json::{Value, json};

use crate::output::{Report, bound, counted, length};

/// Adds what is said of a mesh that was taken out of a model.
pub fn tell(report: &mut Report, said: &Statement, header: &Header) {
    let parts = counted(said.vanished_parts.into(), "part", "parts");
    let Some(distance) = said.vanished_distance else {
        let last = length(header.largest_switch.into());
        let text =
            format!("nothing is drawn, so there is no distance to it: the last of the {parts} vanishes at {last}");
        report.line("error", text);
        return;
    };
    let stated = f64::from(said.error_stated);
    report.line(
        "error",
        match said.guaranteed {
            true if stated == 0.0 => "none: this is the mesh itself".into(),
            true => {
                let text =
                    format!("guaranteed: every point of the input lies within {} of this surface", bound(stated));
                if said.is_two_sided {
                    format!("{text}, and every point of the surface within that of the input")
                } else {
                    text
                }
            }
            false => format!("{} {}", length(stated), why_not_guaranteed(header.error_bound)),
        },
    );
    if said.vanished_parts > 0 {
        let (across, distance) = (bound(said.vanished_diameter.into()), bound(distance.into()));
        report.line(
            "vanished",
            format!(
                "{parts} not drawn, at most {across} across; all their points lie within {distance} of this surface"
            ),
        );
    }
}

/// Why an error that is stated is not guaranteed, behind the number.
pub fn why_not_guaranteed(error_bound: ErrorBound) -> &'static str {
    match error_bound {
        ErrorBound::None => "by the metric's estimate (not guaranteed); build with --error-bound default",
        _ => {
            "by the model's bound, but measured, not guaranteed: the cut mixes levels without the dependency \
             (docs/error.md)"
        }
    }
}

/// Adds what is said of a mesh to a document.
pub fn add_to(document: &mut Value, said: &Statement, header: &Header) {
    document["error_stated"] = json!(said.error_stated);
    document["guaranteed"] = json!(said.guaranteed);
    document["two_sided"] = json!(said.is_two_sided);
    document["error_drawn"] = json!(said.error_drawn);
    document["vanished_parts"] = json!(said.vanished_parts);
    document["vanished_diameter"] = json!(said.vanished_diameter);
    document["vanished_distance"] = json!(said.vanished_distance);
    document["input_error"] = json!(header.input_error);
    document["error_bound"] = json!(header.error_bound.to_string());
}
