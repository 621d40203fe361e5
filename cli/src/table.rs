//! A table as text: columns aligned, the first to the left, the others to the right.

/// What stands where nothing is known.
pub const UNKNOWN: &str = "-";

/// Lines of cells under one line of headings.
#[derive(Debug)]
pub struct Table {
    lines: Vec<Vec<String>>,
}

impl Table {
    /// A table without lines.
    pub fn new(headings: &[&str]) -> Self {
        Table { lines: vec![headings.iter().map(ToString::to_string).collect()] }
    }

    /// Adds a line. It may have fewer cells than there are headings; the last of them may then be as long as it likes.
    pub fn line(&mut self, cells: Vec<String>) {
        self.lines.push(cells);
    }

    /// The table, a line feed behind each line.
    pub fn text(&self) -> String {
        let columns = self.lines[0].len();
        let mut widths = vec![0; columns];
        for line in &self.lines {
            // What ends a short line stretches no column.
            let whole = if line.len() < columns { line.len().saturating_sub(1) } else { columns };
            for (width, cell) in widths.iter_mut().zip(&line[..whole]) {
                *width = (*width).max(cell.chars().count());
            }
        }
        let mut text = String::new();
        for line in &self.lines {
            let cells = line.iter().zip(&widths).enumerate().map(|(column, (cell, &width))| {
                if column == 0 || (column + 1 == line.len() && line.len() < columns) {
                    format!("{cell:<width$}")
                } else {
                    format!("{cell:>width$}")
                }
            });
            text.push_str(cells.collect::<Vec<_>>().join("  ").trim_end());
            text.push('\n');
        }
        text
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_stand_under_each_other() {
        let mut table = Table::new(&["mesh", "triangles", "s"]);
        table.line(vec!["igea".into(), "268,686".into(), "1.25".into()]);
        table.line(vec!["µ".into(), "cannot be read, and this takes long to say".into()]);
        table.line(vec!["dragon".into(), "1,000,000".into(), UNKNOWN.into()]);
        let expected = "mesh    triangles     s\n\
                        igea      268,686  1.25\n\
                        µ       cannot be read, and this takes long to say\n\
                        dragon  1,000,000     -\n";
        assert_eq!(table.text(), expected);
    }
}
