//! Splits and collapses on models of one page.

use metanode::header::Blocking;
use metanode::model::{Model, PageReader};
use metanode::page::Page;

use super::*;
use crate::testing;

#[test]
fn a_vertex_is_a_cache_line_and_a_group_three() {
    assert_eq!((size_of::<Vertex>(), align_of::<Vertex>()), (64, 64));
    assert_eq!((size_of::<Group>(), align_of::<Group>()), (192, 64));
    assert_eq!(VERTEX_BYTES, 106);
}

/// The model of a tree with attributes, all in one page.
fn one_page(mesh: testing::Mesh, most_wedges: usize) -> (Model, Page) {
    let tree = mesh.into_tree(5, 3);
    let attributes = testing::Attributes::with_counts(&tree, 6, |_, random| 1 + random.below(most_wedges));
    let disk = attributes.disk_of(&tree, Blocking::Forest { slot_bytes: 1 << 20, fan_out: 2 });
    let model = Model::open(&disk, "model.vdt".as_ref()).unwrap();
    let mut page = model.empty_page();
    model.read_page(model.root_pages()[0], &[], &mut PageReader::default(), &mut page).unwrap();
    (model, page)
}

/// Everything about a front that splits and collapses may not leave different. Numbers of vertices may differ: leaves do not.
fn state(front: &Front) -> impl PartialEq + use<> {
    let wedges = front.wedges().unwrap();
    // The wedge of a corner, by the bytes of what is drawn of it.
    let wedge = |triangle: u32, place: usize, vertex: u32| {
        let slot = wedges.seams().map_or(vertex, |seams| seams.corners()[triangle as usize][place]);
        let source = wedges.seams().map_or(0, |seams| seams.source(triangle, place));
        (source, bytemuck::cast::<DrawnWedge, [u32; 5]>(wedges.stream()[slot as usize]))
    };
    let corner = |triangle: u32, place: usize, vertex: u32| {
        (front.leaf_at(vertex, triangle), front.interval(vertex), wedge(triangle, place, vertex))
    };
    let mut triangles: Vec<_> = front
        .triangles()
        .map(|(triangle, corners)| [0, 1, 2].map(|place: usize| corner(triangle, place, corners[place])))
        .collect();
    triangles.sort_unstable();
    let vertex = |vertex: u32| {
        let Vertex { span, links, record, .. } = front.vertices[vertex as usize];
        let sphere = front.sphere(vertex);
        (span.start, span.end, span.id, span.moved_by, links.page, record, format!("{sphere:?}"))
    };
    let mut vertices: Vec<_> = front.vertices().map(vertex).collect();
    vertices.sort_unstable();
    (triangles, vertices, front.vanished_trees(), front.used().wedges)
}

/// All splits of a model that fits into one page, down to the leaves, and back: each time what it was before.
#[test]
fn a_collapse_undoes_a_split() {
    let meshes = [testing::Mesh::grid(7, 6, 3), testing::Mesh::sphere(2), testing::Mesh::grid(8, 5, 1).tangled(4)];
    let meshes = meshes.into_iter().chain([testing::Mesh::beside(vec![testing::Mesh::sphere(1); 3])]);
    for (mesh, most_wedges) in meshes.zip([1, 2, 30, 3]) {
        let (model, page) = one_page(mesh, most_wedges);
        let appearance = model.appearance().unwrap();
        let wedges = appearance.wedge_count as usize;
        let header = *model.header();
        let (leaves, triangles) = (header.leaf_count as usize, header.triangle_count as usize);
        let capacity = Capacity { vertices: leaves, triangles, lines: 3 * triangles + 10, born_triangles: 100, wedges };
        let mut front = Front::new(model.roots(), header.leaf_count, capacity).with_wedges(appearance);
        let mut random = testing::Random(1);
        let mut log = Vec::new();
        loop {
            let inner: Vec<u32> = front.vertices().filter(|vertex| !front.is_leaf(*vertex)).collect();
            if inner.is_empty() {
                break;
            }
            let vertex = inner[random.below(inner.len())];
            let before = state(&front);
            let prepared = front.prepare(vertex, &page).unwrap();
            assert!(front.has_room(&prepared));
            let born = front.split(&prepared, &page, 0);
            log.push((born, before));
            assert!(front.vertices().all(|vertex| front.criteria_fit(vertex) == Ok(())));
        }
        assert_eq!((front.vertex_count(), front.triangle_count()), (leaves, triangles));
        for (born, before) in log.into_iter().rev() {
            assert!(front.is_collapsible(born));
            front.collapse(born, page.number());
            assert!(state(&front) == before);
            assert!(front.vertices().all(|vertex| front.criteria_fit(vertex) == Ok(())));
        }
        assert_eq!((front.vertex_count(), front.triangle_count(), front.line_count()), (model.roots().len(), 0, 0));
    }
}

/// Triangles and vertices move to the gaps that others leave, and all that names them goes with them.
#[test]
fn gaps_are_closed() {
    let (model, page) = one_page(testing::Mesh::grid(30, 30, 3), 3);
    let appearance = model.appearance().unwrap();
    let wedges = appearance.wedge_count as usize;
    let header = *model.header();
    let (vertices, triangles) = (header.leaf_count as usize, header.triangle_count as usize);
    let capacity = Capacity { vertices, triangles, lines: 2 * triangles, born_triangles: 100, wedges };
    let mut front = Front::new(model.roots(), header.leaf_count, capacity).with_wedges(appearance);
    let inner = |front: &Front| front.vertices().find(|vertex| !front.is_leaf(*vertex));
    while let Some(vertex) = inner(&front) {
        let prepared = front.prepare(vertex, &page).unwrap();
        front.split(&prepared, &page, 0);
    }
    for _ in 0..vertices / 2 {
        let born = front.born().find(|born| front.is_collapsible(*born)).unwrap();
        front.collapse(born, page.number());
    }
    front.clear_changes();
    let (before, gaps) = (state(&front), front.corners().len() - front.triangle_count());
    front.close_gaps(3);
    let (_, changed) = front.changes();
    assert!(changed.ranges(0).next().is_some());
    front.close_gaps(usize::MAX);
    assert!(state(&front) == before);
    let places = front.vertex_bound() as usize;
    assert!(places - front.vertex_count() <= (places / 8).max(CHUNK));
    let left = front.corners().len() - front.triangle_count();
    assert!(gaps > triangles / 5 && left <= triangles / 8, "{gaps} gaps, {left} left");
    // And it goes on from there, with gaps closed all the way: down to the roots, and to the leaves.
    let whole = |front: &Front| front.vertices().all(|vertex| front.criteria_fit(vertex) == Ok(()));
    let undoable = |front: &Front| front.born().find(|born| front.is_collapsible(*born));
    while let Some(born) = undoable(&front) {
        front.collapse(born, page.number());
        front.close_gaps(2);
        assert!(whole(&front));
    }
    assert_eq!((front.vertex_count(), front.triangle_count(), front.line_count()), (model.roots().len(), 0, 0));
    while let Some(vertex) = inner(&front) {
        let prepared = front.prepare(vertex, &page).unwrap();
        front.split(&prepared, &page, 0);
        front.close_gaps(1);
    }
    assert!(whole(&front));
    assert_eq!((front.vertex_count(), front.triangle_count()), (vertices, triangles));
}

/// A split that was undone in the same frame, as of a wish that could not come true, once counted as a vertex on its way. With such a
/// wish in every frame, a camera that stood still never had its picture finished.
#[test]
fn what_is_undone_is_not_on_its_way() {
    let (model, page) = one_page(testing::Mesh::grid(7, 6, 3), 1);
    let header = *model.header();
    let (vertices, triangles) = (header.leaf_count as usize, header.triangle_count as usize);
    let capacity = Capacity { vertices, triangles, lines: 3 * triangles + 10, born_triangles: 100, wedges: 0 };
    let mut front = Front::new(model.roots(), header.leaf_count, capacity).with_morphs(3);
    let prepared = front.prepare(0, &page).unwrap();
    let born = front.split(&prepared, &page, 0);
    assert_eq!(front.under_way(), 1);
    front.collapse(born, page.number());
    assert_eq!(front.under_way(), 0);
    // What gets its number is.
    let prepared = front.prepare(0, &page).unwrap();
    assert_eq!((front.split(&prepared, &page, 0), front.under_way()), (born, 1));
    (0..3).for_each(|_| front.step_morphs());
    assert_eq!(front.under_way(), 0);
}

/// There is room for a split as long as there are slots for its wedges.
#[test]
fn slots_are_counted() {
    let (model, page) = one_page(testing::Mesh::grid(20, 20, 3), 5);
    let (header, appearance) = (*model.header(), model.appearance().unwrap());
    let (vertices, triangles) = (header.leaf_count as usize, header.triangle_count as usize);
    let wedges = (appearance.wedge_count as usize / 2).next_multiple_of(CHUNK);
    let capacity = Capacity { vertices, triangles, lines: 2 * triangles, born_triangles: 100, wedges };
    let mut front = Front::new(model.roots(), header.leaf_count, capacity).with_wedges(appearance);
    loop {
        let vertex = front.vertices().find(|vertex| !front.is_leaf(*vertex)).unwrap();
        let prepared = front.prepare(vertex, &page).unwrap();
        if !front.has_room(&prepared) {
            break;
        }
        front.split(&prepared, &page, 0);
    }
    let used = front.used();
    assert!(used.vertices < vertices && used.wedges <= wedges && used.wedges + 5 > wedges, "{used:?} {wedges}");
}

/// What a page says of wedges and cannot be is refused before anything is changed: those of the same tree with other wedges.
#[test]
fn wedges_that_do_not_fit_are_told() {
    let mesh = testing::Mesh::grid(12, 12, 3);
    let ((model, page), (_, other)) = (one_page(mesh.clone(), 3), one_page(mesh, 2));
    let (header, appearance) = (*model.header(), model.appearance().unwrap());
    let (vertices, triangles) = (header.leaf_count as usize, header.triangle_count as usize);
    let wedges = appearance.wedge_count as usize;
    let capacity = Capacity { vertices, triangles, lines: 2 * triangles, born_triangles: 100, wedges };
    let mut front = Front::new(model.roots(), header.leaf_count, capacity).with_wedges(appearance);
    let (mut late, mut lost, mut moved) = (0, 0, 0);
    let inner = |front: &Front| front.vertices().find(|vertex| !front.is_leaf(*vertex));
    while let Some(vertex) = inner(&front) {
        let before = state(&front);
        match front.prepare(vertex, &other).map_err(|misfit| misfit.problem) {
            Ok(_) => (),
            Err(problem) if problem.contains("does not come after") => late += 1,
            Err(problem) if problem.contains("has none that is drawn") => lost += 1,
            Err(problem) if problem.contains("turns into none of leaf") => moved += 1,
            Err(problem) => panic!("{problem}"),
        }
        assert!(state(&front) == before);
        let prepared = front.prepare(vertex, &page).unwrap();
        front.split(&prepared, &page, 0);
    }
    assert!(late > 0 && lost > 0 && moved > 0, "{late} {lost} {moved}");
}
