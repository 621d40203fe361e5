//! A strategy as the benches take it: with its B-tree of edges, since these move different amounts of bytes.

use std::ffi::OsString;
use std::fmt;
use std::str::FromStr;

use metanode::header::Strategy;
use storage::EdgeTreeKind;

use super::build_options;

/// A strategy, with the B-tree that it keeps its edges in where it has one: `passes`, `btree:redb`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct StrategyChoice {
    strategy: Strategy,
    edge_tree: Option<EdgeTreeKind>,
}

impl StrategyChoice {
    /// Options of `vdt build` that ask for it.
    pub fn options(self) -> Vec<OsString> {
        build_options(&[
            ("--strategy", Some(self.strategy.to_string())),
            ("--edge-tree", self.edge_tree.map(|tree| tree.to_string())),
        ])
    }
}

impl FromStr for StrategyChoice {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let (name, tree) = match text.split_once(':') {
            Some((name, tree)) => (name, Some(tree)),
            None => (text, None),
        };
        let strategy: Strategy = name.parse().map_err(|error| format!("{error}"))?;
        let edge_tree = tree.map(str::parse::<EdgeTreeKind>).transpose().map_err(|error| error.to_string())?;
        match (strategy, edge_tree) {
            (Strategy::Passes, Some(_)) => Err("passes has no tree of edges; write passes alone".into()),
            (Strategy::Btree, None) => Ok(StrategyChoice { strategy, edge_tree: Some(EdgeTreeKind::default()) }),
            _ => Ok(StrategyChoice { strategy, edge_tree }),
        }
    }
}

impl fmt::Display for StrategyChoice {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.edge_tree {
            Some(tree) => out.pad(&format!("{}:{tree}", self.strategy)),
            None => out.pad(&self.strategy.to_string()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn strategies_as_people_write_them() {
        let shown = |text: &str| text.parse::<StrategyChoice>().map(|choice| choice.to_string());
        assert_eq!(shown("passes"), Ok("passes".into()));
        assert_eq!(shown("btree:sled"), Ok("btree:sled".into()));
        assert_eq!(shown("btree"), Ok("btree:redb".into()));
        for wrong in ["passes:redb", "btree:", "btree:oak", "rounds"] {
            assert!(shown(wrong).is_err(), "{wrong}");
        }
    }
}
