//! What can be said of a surface drawn from a model: how far the input is from it, at most, and whether that is proven.
//!
//! With certified switch values, each triangle drawn stands for a piece of the input, and has a corner whose switch value is
//! no less than the distance from any point of the piece to the triangle. That holds for the states that the construction
//! went through in some order: uniform cuts, since switch values never fall from a collapse to one that depends on it, and
//! those in which the implicit dependency is kept. On top comes the input error, what was lost before the first collapse. A
//! fully refined part is the mesh itself and needs no bound. Parts that have vanished whole are stood for by nothing;
//! their points have a distance of their own (module `vanished`).

use vdt::tree::rounded_up;

use crate::header::Header;
use crate::vanished::VanishedParts;

/// What is said of a surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Statement {
    /// No point of the input is farther than this from the surface, in mesh units. Where nothing is drawn of a mesh that
    /// has triangles there is no such distance; then it is the largest switch value, and not guaranteed.
    pub error_stated: f32,
    /// Whether that is proven; else it is the metric's estimate, or a bound outside of what it was proven for.
    pub guaranteed: bool,
    /// Whether it is proven, too, that no point of the surface is farther than `error_drawn` from the input.
    pub is_two_sided: bool,
    /// The same as `error_stated`, for the points of the parts that are drawn at least in part.
    pub error_drawn: f32,
    /// Parts (trees, that is components) that are not drawn at all.
    pub vanished_parts: u32,
    /// None of them is larger across than this, in mesh units.
    pub vanished_diameter: f32,
    /// No point of theirs is farther than this from the surface, in mesh units, the input error included; `None` where
    /// nothing is drawn.
    pub vanished_distance: Option<f32>,
}

/// What is drawn of a model.
#[derive(Debug, Clone, Copy)]
pub struct Drawn<'a> {
    /// The largest switch value of the nodes that are drawn unsplit, in trees with an active triangle; 0 without any.
    pub largest_switch: f32,
    /// Whether the surface is a state of the construction: the cut is uniform, or keeps the implicit dependency.
    pub is_a_state: bool,
    /// The trees without an active triangle, which all the vertices of active triangles have passed.
    pub vanished: &'a VanishedParts,
}

impl Statement {
    /// What can be said of what is drawn of the model with this header.
    pub fn new(header: &Header, drawn: Drawn<'_>) -> Self {
        let Drawn { largest_switch, is_a_state, vanished } = drawn;
        let error_drawn = sum_not_below(largest_switch, header.input_error);
        let vanished_distance = match vanished.count() {
            0 => Some(0.0),
            _ => vanished.distance().map(|distance| sum_not_below(distance, header.input_error)),
        };
        let (error_stated, is_drawn) = match vanished_distance {
            Some(distance) => (error_drawn.max(distance), true),
            None => (header.largest_switch, false),
        };
        let guaranteed = is_drawn && is_proven(header, is_a_state, largest_switch);
        Statement {
            error_stated,
            guaranteed,
            is_two_sided: guaranteed && (header.error_bound.is_two_sided() || largest_switch == 0.0),
            error_drawn,
            vanished_parts: vanished.count(),
            vanished_diameter: vanished.diameter(),
            vanished_distance,
        }
    }
}

/// Whether what switch values up to `largest_switch` say of what is drawn is proven; see [`Drawn`].
pub fn is_proven(header: &Header, is_a_state: bool, largest_switch: f32) -> bool {
    // No node but a leaf has the value 0: then what is drawn is the mesh itself.
    largest_switch == 0.0 || header.error_bound.is_certified() && is_a_state
}

/// The smallest f32 that is not below the sum of two lengths, or the next one.
pub fn sum_not_below(one: f32, other: f32) -> f32 {
    if one == 0.0 || other == 0.0 {
        return one.max(other);
    }
    // The sum in double precision may have been rounded down.
    rounded_up((f64::from(one) + f64::from(other)).next_up())
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;
    use vdt::tree::ErrorBound;

    use super::*;
    use crate::header::Blocking;
    use crate::model::Model;
    use crate::testing::{Shape, TreePlan, model, random_tree};

    fn some_model() -> Model {
        let plan =
            TreePlan { seed: 3, leaves: 40, components: 4, triangles: 80, shape: Shape::Random, hub: 0, reach: 30 };
        model(&random_tree(&plan), Blocking::default())
    }

    #[test]
    fn nothing_drawn_has_no_distance_and_no_guarantee() {
        let model = some_model();
        let vanished = VanishedParts::new(model.roots().iter());
        let drawn = Drawn { largest_switch: 0.0, is_a_state: true, vanished: &vanished };
        let said = Statement::new(model.header(), drawn);
        assert_eq!((said.error_stated, said.guaranteed), (model.header().largest_switch, false));
        assert_eq!((said.vanished_parts, said.vanished_distance), (model.header().root_count, None));
    }

    #[test]
    fn a_statement_is_proven_where_bound_and_cut_are() {
        let header = *some_model().header();
        let vanished = VanishedParts::default();
        let proven = |error_bound: ErrorBound, is_a_state: bool, largest_switch: f32| {
            let drawn = Drawn { largest_switch, is_a_state, vanished: &vanished };
            Statement::new(&crate::header::Header { error_bound, ..header }, drawn).guaranteed
        };
        for error_bound in ErrorBound::ALL.into_iter().filter(|bound| bound.is_certified()) {
            assert!(
                proven(error_bound, true, 1.0) && !proven(error_bound, false, 1.0) && proven(error_bound, false, 0.0)
            );
        }
        assert!(!proven(ErrorBound::None, true, 1.0) && proven(ErrorBound::None, false, 0.0));
    }

    #[test]
    fn a_statement_is_two_sided_where_the_bound_is() {
        let header = *some_model().header();
        let vanished = VanishedParts::default();
        for error_bound in ErrorBound::ALL {
            for (is_a_state, largest_switch) in [(true, 1.0), (false, 1.0), (false, 0.0)] {
                let header = crate::header::Header { error_bound, ..header };
                let said = Statement::new(&header, Drawn { largest_switch, is_a_state, vanished: &vanished });
                let expected = largest_switch == 0.0 || is_a_state && error_bound == ErrorBound::TwoSided;
                assert_eq!(said.is_two_sided, expected, "{error_bound} {is_a_state} {largest_switch}");
            }
        }
    }

    #[test]
    fn the_input_error_is_on_top_of_everything() {
        let model = some_model();
        let header = crate::header::Header { input_error: 0.25, ..*model.header() };
        let mut vanished = VanishedParts::new(model.roots()[..1].iter());
        vanished.pass(model.roots()[1].position);
        let alone = vanished.distance().unwrap();
        let drawn = Drawn { largest_switch: 0.5, is_a_state: true, vanished: &vanished };
        let said = Statement::new(&header, drawn);
        assert!(said.error_drawn >= 0.75 && said.error_drawn < 0.750_001);
        let distance = said.vanished_distance.unwrap();
        assert!(distance >= alone + 0.25 && distance < (alone + 0.25) * 1.000_001);
        assert_eq!(said.error_stated, said.error_drawn.max(distance));
    }

    proptest! {
        #[test]
        fn sums_are_never_too_small(one in 0.0..9.0_f32, other in prop_oneof![Just(0.0_f32), Just(1e-30), 0.0..9.0_f32]) {
            let sum = sum_not_below(one, other);
            let exact = f64::from(one) + f64::from(other);
            prop_assert!(f64::from(sum) >= exact && (other > 0.0 || sum == one));
            prop_assert!(f64::from(sum) <= exact * 1.000_000_3 + 1e-44);
            prop_assert!(one == 0.0 || other == 0.0 || f64::from(sum) > f64::from(one));
        }
    }
}
