//! What `vdt build --json` says of a build, as far as the benches show it. What it does not say is unknown, not zero.

use serde_json::{Value, json};

use crate::output::grouped;
use crate::table::UNKNOWN;

/// The phases of a build, in order, by the names that programs know.
pub const PHASES: [&str; 4] = ["ingest", "simplify", "number", "write"];

/// A finished build.
#[derive(Debug, Clone, PartialEq)]
pub struct Figures {
    document: Value,
}

/// What one phase of a build took.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Phase {
    /// Wall-clock seconds.
    pub seconds: f64,
    /// CPU seconds of all threads.
    pub cpu_seconds: f64,
    /// Bytes read, as the operating system counts them.
    pub bytes_read: u64,
    /// Bytes written.
    pub bytes_written: u64,
}

impl Figures {
    /// From what a build printed.
    pub fn new(document: Value) -> Self {
        Figures { document }
    }

    /// A whole number that the build printed.
    pub fn whole(&self, key: &str) -> Option<u64> {
        self.document[key].as_u64()
    }

    /// A number that the build printed.
    pub fn float(&self, key: &str) -> Option<f64> {
        self.document[key].as_f64()
    }

    /// One of the [`PHASES`].
    pub fn phase(&self, name: &str) -> Option<Phase> {
        let phase = self.document["phases"].as_array()?.iter().find(|phase| phase["name"] == name)?;
        Some(Phase {
            seconds: phase["seconds"].as_f64()?,
            cpu_seconds: phase["cpu_seconds"].as_f64()?,
            bytes_read: phase["bytes_read"].as_u64()?,
            bytes_written: phase["bytes_written"].as_u64()?,
        })
    }

    /// All phases, if all are known.
    pub fn phases(&self) -> Option<[Phase; 4]> {
        let [ingest, simplify, number, write] = PHASES.map(|name| self.phase(name));
        Some([ingest?, simplify?, number?, write?])
    }

    /// Seconds in which the view-dependence tree was made.
    pub fn tree_seconds(&self) -> Option<f64> {
        self.phases().map(|[ingest, simplify, number, _]| ingest.seconds + simplify.seconds + number.seconds)
    }

    /// Seconds in which the meta-nodes were made.
    pub fn meta_node_seconds(&self) -> Option<f64> {
        self.phase("write").map(|write| write.seconds)
    }

    /// Triangles of the input for each second of CPU time.
    pub fn triangles_per_cpu_second(&self) -> Option<f64> {
        let seconds = self.float("cpu_seconds").filter(|seconds| *seconds > 0.0)?;
        Some(self.whole("input_triangles")? as f64 / seconds)
    }

    /// Bytes read and written by the build, as the operating system counts them: those of the phases. (The figures for
    /// the whole process have, on top, that `--json` reads the model again for its digest.)
    pub fn bytes_moved(&self) -> Option<[u64; 2]> {
        // Where the system does not count, the phases have zeros.
        self.whole("io_read_bytes")?;
        let phases = self.phases()?;
        Some([phases.iter().map(|phase| phase.bytes_read).sum(), phases.iter().map(|phase| phase.bytes_written).sum()])
    }

    /// Bytes read and written for each triangle of the input.
    pub fn bytes_per_triangle(&self) -> Option<[f64; 2]> {
        let triangles = self.whole("input_triangles").filter(|triangles| *triangles > 0)? as f64;
        self.bytes_moved().map(|moved| moved.map(|bytes| bytes as f64 / triangles))
    }

    /// Everything that the build printed.
    pub fn document(&self) -> &Value {
        &self.document
    }

    /// The phases as JSON, each with what it moved for each triangle of the input.
    pub fn phases_json(&self) -> Value {
        let triangles = self.whole("input_triangles").unwrap_or(0).max(1) as f64;
        let phases = PHASES.iter().filter_map(|name| Some((name, self.phase(name)?)));
        let phases = phases.map(|(name, phase)| {
            json!({
                "name": name,
                "seconds": phase.seconds,
                "cpu_seconds": phase.cpu_seconds,
                "bytes_read": phase.bytes_read,
                "bytes_written": phase.bytes_written,
                "bytes_read_per_triangle": phase.bytes_read as f64 / triangles,
                "bytes_written_per_triangle": phase.bytes_written as f64 / triangles,
            })
        });
        phases.collect()
    }
}

/// A whole number as a cell of a table.
pub fn whole_cell(number: Option<u64>) -> String {
    number.map_or(UNKNOWN.into(), grouped)
}

/// A number as a cell of a table: three decimals below 1, two below 100, whole above.
pub fn float_cell(number: Option<f64>) -> String {
    match number {
        None => UNKNOWN.into(),
        Some(0.0) => "0".into(),
        Some(number) if number < 0.9995 => format!("{number:.3}"),
        Some(number) if number < 99.995 => format!("{number:.2}"),
        Some(number) => grouped(number.round() as u64),
    }
}

/// Bytes as a cell of a column in MiB.
pub fn mebibytes_cell(bytes: Option<u64>) -> String {
    float_cell(bytes.map(|bytes| bytes as f64 / f64::from(1 << 20)))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn build() -> Value {
        let phase = |name: &str, number: u64| {
            json!({
                "name": name, "seconds": number, "cpu_seconds": 2 * number,
                "bytes_read": 100 * number, "bytes_written": 1000 * number,
            })
        };
        json!({
            "input_triangles": 50,
            "cpu_seconds": 20.0,
            "io_read_bytes": 1001,
            "phases": [phase("ingest", 1), phase("simplify", 2), phase("number", 3), phase("write", 4)],
        })
    }

    #[test]
    fn figures_of_a_build() {
        let figures = Figures::new(build());
        assert_eq!((figures.tree_seconds(), figures.meta_node_seconds()), (Some(6.0), Some(4.0)));
        assert_eq!(figures.triangles_per_cpu_second(), Some(2.5));
        assert_eq!(figures.bytes_moved(), Some([1000, 10_000]));
        assert_eq!(figures.bytes_per_triangle(), Some([20.0, 200.0]));
        assert_eq!(figures.phases_json()[2]["bytes_written_per_triangle"], 60.0);
    }

    #[test]
    fn what_a_build_does_not_say_is_unknown() {
        let mut document = build();
        document["phases"].as_array_mut().unwrap().remove(2);
        let figures = Figures::new(document);
        assert_eq!((figures.tree_seconds(), figures.bytes_per_triangle()), (None, None));
        assert_eq!((figures.meta_node_seconds(), figures.whole("passes")), (Some(4.0), None));
        assert_eq!(figures.phases_json().as_array().unwrap().len(), 3);
        let none = Figures::new(json!({}));
        assert_eq!((none.triangles_per_cpu_second(), none.phases()), (None, None));
        assert_eq!((whole_cell(None), float_cell(None)), ("-".to_owned(), "-".to_owned()));
    }

    #[test]
    fn cells() {
        assert_eq!(whole_cell(Some(1_234_567)), "1,234,567");
        assert_eq!((float_cell(Some(0.01234)), float_cell(Some(0.9996))), ("0.012".to_owned(), "1.00".to_owned()));
        assert_eq!((float_cell(Some(0.0)), float_cell(Some(1.234))), ("0".to_owned(), "1.23".to_owned()));
        assert_eq!(float_cell(Some(12_345.6)), "12,346");
        assert_eq!(mebibytes_cell(Some(3 << 19)), "1.50");
    }
}
