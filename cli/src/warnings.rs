//! What was changed or not found while meshes were read, in words and for programs.

use std::path::{Path, PathBuf};

use serde_json::{Value, json};
use vdt::ingest::CleaningCounts;

use crate::output::{Report, grouped};

/// Adds a line for each.
pub fn tell(report: &mut Report, cleaning: &CleaningCounts, missing_files: &[PathBuf]) {
    for (_, count, message) in counted(cleaning) {
        report.line("note", format!("{} {message}", grouped(count)));
    }
    for path in missing_files {
        report.line("missing", missing(path));
    }
}

fn missing(path: &Path) -> String {
    format!("{}: named by the mesh, and not there; done without it", path.display())
}

/// The same, each by itself.
pub fn texts(cleaning: &CleaningCounts, missing_files: &[PathBuf]) -> Vec<String> {
    let counted = counted(cleaning).into_iter().map(|(_, count, message)| format!("{} {message}", grouped(count)));
    counted.chain(missing_files.iter().map(|path| missing(path))).collect()
}

/// The same for programs.
pub fn to_json(cleaning: &CleaningCounts, missing_files: &[PathBuf]) -> Vec<Value> {
    let counted = counted(cleaning)
        .into_iter()
        .map(|(kind, count, message)| json!({ "kind": kind, "count": count, "message": message }));
    let missing = missing_files.iter().map(|path| {
        let path = path.display().to_string();
        json!({ "kind": "missing_file", "path": path, "message": "is named by the mesh and not there; done without it" })
    });
    counted.chain(missing).collect()
}

/// What was changed on the way in: a name for programs, how often, and a sentence for people that begins with the number.
fn counted(cleaning: &CleaningCounts) -> Vec<(&'static str, u64, &'static str)> {
    let CleaningCounts {
        welded_vertices,
        fallen_vertices,
        isolated_vertices,
        degenerate_triangles,
        duplicate_triangles,
        degenerate_faces,
        polygons,
        merged_wedges,
        skipped_elements,
    } = *cleaning;
    [
        ("welded_vertices", welded_vertices, "vertices had the position of another one and were welded to it"),
        ("fallen_vertices", fallen_vertices, "vertices fell together with others on the lattice of the positions"),
        ("isolated_vertices", isolated_vertices, "vertices that no triangle uses were left out"),
        ("degenerate_triangles", degenerate_triangles, "triangles with two corners at one position were left out"),
        ("duplicate_triangles", duplicate_triangles, "triangles were there before and were left out"),
        ("degenerate_faces", degenerate_faces, "faces of fewer than three corners were left out"),
        ("polygons", polygons, "polygons were cut into triangles"),
        ("merged_wedges", merged_wedges, "attributes were more than one vertex can have, and were given up"),
        ("skipped_elements", skipped_elements, "points, lines or curves are no part of a surface and were left out"),
    ]
    .into_iter()
    .filter(|(_, count, _)| *count > 0)
    .collect()
}
