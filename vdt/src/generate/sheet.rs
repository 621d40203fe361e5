//! How an open sheet of exactly so many triangles is put together: a grid of squares, each cut in two, and on top
//! of it a part of one more row.

use crate::mesh::MeshError;

use super::TriangleSink;

/// A rectangular grid of `columns` by `rows` squares, and the first `extra` triangles of a row more.
///
/// A manifold with one boundary. Vertices are numbered row by row.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Sheet {
    /// Squares in a row.
    pub(super) columns: u64,
    /// Whole rows of squares.
    pub(super) rows: u64,
    /// Triangles in the row that is not whole.
    pub(super) extra: u64,
}

impl Sheet {
    /// The sheet of `triangles` triangles (1 or more) that is as near to a square as can be.
    pub(super) fn with_triangles(triangles: u64) -> Self {
        let columns = (triangles / 2).isqrt().max(1);
        Sheet { columns, rows: triangles / (2 * columns), extra: triangles % (2 * columns) }
    }

    /// Rows of vertices, and of squares if the last one is counted as a whole.
    pub(super) fn lines(&self) -> (u64, u64) {
        let squares = self.rows + u64::from(self.extra > 0);
        (squares + 1, squares)
    }

    /// Vertices in one row of vertices.
    pub(super) fn row_vertices(&self, row: u64) -> u64 {
        if row <= self.rows { self.columns + 1 } else { self.extra / 2 + 1 }
    }

    /// Vertices in all.
    pub(super) fn vertices(&self) -> u64 {
        let whole = (self.rows + 1) * (self.columns + 1);
        if self.extra > 0 { whole + self.row_vertices(self.rows + 1) } else { whole }
    }

    /// Triangles in all.
    pub(super) fn triangles(&self) -> u64 {
        2 * self.columns * self.rows + self.extra
    }

    /// Every triangle once, counter-clockwise where columns run right and rows run up. `base` is the number of the
    /// first vertex.
    pub(super) fn emit_triangles(&self, base: u64, emit: &mut TriangleSink<'_>) -> Result<(), MeshError> {
        for row in 0..self.lines().1 {
            let below = base + row * (self.columns + 1);
            let above = below + self.columns + 1;
            let count = if row < self.rows { 2 * self.columns } else { self.extra };
            for column in 0..count / 2 {
                emit([below + column, below + column + 1, above + column])?;
                emit([below + column + 1, above + column + 1, above + column])?;
            }
            if count % 2 == 1 {
                let column = count / 2;
                emit([below + column, below + column + 1, above + column])?;
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn any_number_of_triangles_and_no_vertex_without_one() {
        for wanted in 1..2000 {
            let sheet = Sheet::with_triangles(wanted);
            let mut used = vec![false; sheet.vertices() as usize];
            let mut count = 0;
            let mut mark = |corners: [u64; 3]| {
                corners.into_iter().for_each(|corner| used[corner as usize - 7] = true);
                count += 1;
                Ok(())
            };
            sheet.emit_triangles(7, &mut mark).unwrap();
            assert_eq!((count, sheet.triangles()), (wanted, wanted));
            assert!(used.into_iter().all(|used| used), "{sheet:?}");
            let rows: u64 = (0..sheet.lines().0).map(|row| sheet.row_vertices(row)).sum();
            assert_eq!(rows, sheet.vertices());
        }
    }
}
