//! What a picture shows.

use glam::dvec3;

use super::image::{BACKGROUND, lit};
use super::*;
use geometry::mesh::TriMesh;
use geometry::mesh::shapes::Shape;

const RED: Rgb = [220, 40, 40];
const BLUE: Rgb = [40, 60, 220];
const FRONT: ViewDirection = ViewDirection { toward: DVec3::Z, up: DVec3::Y };

/// Two triangles: the square from (x, y, z) with this side, facing +z.
fn square([x, y, z]: [f64; 3], side: f64, colour: Rgb) -> Vec<Face> {
    let corners = [[0., 0.], [1., 0.], [1., 1.], [0., 1.]].map(|[u, v]| dvec3(x + side * u, y + side * v, z));
    Face::fan(&corners, colour, None).collect()
}

/// A canvas of 100 by 100 pixels on which the unit square is seen face on, from pixel 3 to pixel 97.
fn canvas(toward: DVec3) -> Canvas {
    let frame = [DVec3::ZERO, dvec3(1.0, 1.0, 0.0)];
    Canvas::new(View::framing(&ViewDirection { toward, up: DVec3::Y }, Size::new(100, 100).unwrap(), frame).unwrap())
}

fn pens() -> Pens {
    Pens { fine_width: 2.0, fine_strength: 1.0, bold_width: 4.0, dot_width: 6.0 }
}

fn ink(c: Rgb) -> bool {
    c.iter().all(|&c| c < 60)
}

fn front(c: Rgb) -> Rgb {
    lit(c, DVec3::Z, false)
}

#[test]
fn a_square_covers_its_pixels_and_no_others() {
    let mut canvas = canvas(DVec3::Z);
    canvas.faces(&square([0.0; 3], 1.0, RED));
    let image = canvas.finish(&pens());
    for (x, y) in (0..100).flat_map(|y| (0..100).map(move |x| (x, y))) {
        let inside = (3..97).contains(&x) && (3..97).contains(&y);
        let expected = if inside { front(RED) } else { BACKGROUND };
        assert_eq!(image.pixel(x, y), Some(expected), "({x}, {y})");
    }
    assert_eq!((image.pixel(100, 0), image.pixel(0, 100)), (None, None));
}

#[test]
fn up_is_up_and_right_is_right() {
    let mut canvas = canvas(DVec3::Z);
    canvas.faces(&square([0.6, 0.7, 0.0], 0.2, RED));
    let image = canvas.finish(&pens());
    assert_eq!(image.pixel(69, 22), Some(front(RED)));
    assert_eq!(image.pixel(69, 78), Some(BACKGROUND));
}

#[test]
fn the_nearer_face_hides_the_farther_one_in_any_order() {
    let (near, far) = (square([0.2, 0.2, 0.5], 0.5, RED), square([0.0, 0.0, 0.0], 1.0, BLUE));
    let draw = |first: &[Face], then: &[Face]| {
        let mut canvas = canvas(DVec3::Z);
        canvas.faces(first);
        canvas.faces(then);
        canvas.finish(&pens())
    };
    let image = draw(&near, &far);
    assert_eq!(image, draw(&far, &near));
    assert_eq!(image.pixel(45, 55), Some(front(RED)));
    assert_eq!(image.pixel(90, 90), Some(front(BLUE)));
}

#[test]
fn faces_that_cross_hide_each_other_in_part() {
    let slope = |tilt: f64, colour| {
        let corners =
            [[0., 0., 0.], [1., 0., tilt], [1., 1., tilt], [0., 1., 0.]].map(|[x, y, z]| dvec3(x, y, z - 0.5 * tilt));
        Face::fan(&corners, colour, Some(DVec3::Z)).collect::<Vec<_>>()
    };
    let mut canvas = canvas(DVec3::Z);
    canvas.faces(&[slope(1.0, RED), slope(-1.0, BLUE)].concat());
    let image = canvas.finish(&pens());
    assert_eq!((image.pixel(25, 50), image.pixel(75, 50)), (Some(front(BLUE)), Some(front(RED))));
}

#[test]
fn common_edges_have_no_gaps_and_no_overlaps() {
    let rim = (0..=41).map(|i| f64::from(i % 41) / 41.0 * std::f64::consts::TAU);
    let rim: Vec<DVec3> = rim.map(|a| dvec3(0.5 + 0.5 * a.cos(), 0.5 + 0.5 * a.sin(), 0.0)).collect();
    let apex = dvec3(0.512_345, 0.487_654, 0.0);
    let fan = |colour: &dyn Fn(u32) -> Rgb| {
        let face = |i: usize| Face { corners: [apex, rim[i], rim[i + 1]], colour: colour(i as u32), normal: None };
        (0..41).map(face).collect::<Vec<_>>()
    };
    let draw = |faces: &[Face]| {
        let mut canvas = canvas(DVec3::Z);
        canvas.faces(faces);
        canvas.finish(&pens())
    };
    // Through a gap the background would show.
    let image = draw(&fan(&|_| RED));
    for (x, y) in (18..82).flat_map(|y| (18..82).map(move |x| (x, y))) {
        assert_eq!(image.pixel(x, y), Some(front(RED)), "({x}, {y})");
    }
    // Of faces that overlap at one depth the first shows, so the order would.
    let mut colourful = fan(&distinct);
    let image = draw(&colourful);
    colourful.reverse();
    assert_eq!(image, draw(&colourful));
}

#[test]
fn the_back_has_another_tint() {
    let mut canvas = canvas(DVec3::NEG_Z);
    canvas.faces(&square([0.0; 3], 1.0, RED));
    let colour = canvas.finish(&pens()).pixel(50, 50);
    assert_eq!(colour, Some(lit(RED, DVec3::Z, true)));
    assert_ne!(colour, Some(front(RED)));
}

#[test]
fn a_line_shows_on_its_surface_and_not_behind_it() {
    for tilt in [0.0, 0.5, 3.0, -3.0] {
        // The line lies in the square, so it shows from both sides.
        let [a, b, c, d] = [[0., 0.], [1., 0.], [1., 1.], [0., 1.]].map(|[x, y]| dvec3(x, y, tilt * x));
        for toward in [DVec3::Z, DVec3::NEG_Z] {
            let mut canvas = canvas(toward);
            canvas.faces(&Face::fan(&[a, b, c, d], RED, None).collect::<Vec<_>>());
            canvas.line(a, c);
            let image = canvas.finish(&pens());
            let seen =
                (10..90).filter(|&i| ink(image.pixel(i, if toward.z > 0.0 { 99 - i } else { i }).unwrap())).count();
            assert_eq!(seen, 80, "slope {tilt} from {toward}");
        }
        let mut canvas = canvas(DVec3::Z);
        canvas.faces(&Face::fan(&[a, b, c, d], RED, None).collect::<Vec<_>>());
        let below = dvec3(0.0, 0.0, 0.1);
        canvas.bold_line(a - below, c - below);
        canvas.dot(0.5 * (b + d) - below);
        let image = canvas.finish(&pens());
        let seen = (10..90).filter(|&i| ink(image.pixel(i, 99 - i).unwrap())).count();
        assert_eq!(seen, 0, "slope {tilt}");
    }
}

#[test]
fn lines_have_their_width_and_strength() {
    let rows = |pens: Pens, draw: &dyn Fn(&mut Canvas)| {
        let mut canvas = canvas(DVec3::Z);
        canvas.faces(&square([0.0; 3], 1.0, RED));
        draw(&mut canvas);
        let image = canvas.finish(&pens);
        (0..100).filter(|&y| image.pixel(50, y).unwrap() != front(RED)).count() - 6
    };
    // The middle of the square is the edge between two rows of pixels.
    let (from, to) = (dvec3(0.0, 0.5, 0.0), dvec3(1.0, 0.5, 0.0));
    assert_eq!(rows(pens(), &|canvas| canvas.line(from, to)), 2);
    assert_eq!(rows(pens(), &|canvas| canvas.bold_line(from, to)), 4);
    assert_eq!(rows(pens(), &|canvas| canvas.dot(dvec3(0.5, 0.5, 0.0))), 6);
    assert_eq!(rows(Pens { fine_strength: 0.0, ..pens() }, &|canvas| canvas.line(from, to)), 0);
    for spacing in [-1.0, 0.0, 0.3, 3.0, 1e9, f64::NAN, f64::INFINITY] {
        let pens = Pens::for_spacing(spacing);
        assert!((0.6..=1.5).contains(&pens.fine_width) && (0.1..=0.85).contains(&pens.fine_strength), "{pens:?}");
    }
}

#[test]
fn the_same_bytes_with_any_number_of_threads() {
    let mesh = Shape::Torus.build(3000);
    let corners = mesh.positions().to_vec();
    let draw = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let view = View::framing(&ViewDirection::default(), Size::new(301, 203).unwrap(), corners.clone()).unwrap();
            draw_mesh((&mesh, None), view, Paint::Cell, &[[corners[0], corners[1]]]).to_png().unwrap()
        })
    };
    let one = draw(1);
    assert_eq!(one[1..4], *b"PNG");
    assert!(one == draw(3) && one == draw(1));
}

#[test]
fn nothing_and_nonsense_give_the_background() {
    let size = Size::new(40, 30).unwrap();
    let huge = f64::MAX;
    let points = [
        [DVec3::ZERO; 3],
        [DVec3::X; 3],
        [DVec3::ZERO, DVec3::X, 2.0 * DVec3::X],
        [DVec3::NAN, DVec3::X, DVec3::Y],
        [DVec3::INFINITY, DVec3::X, DVec3::NEG_INFINITY],
        // Seen along its plane.
        [DVec3::ZERO, dvec3(0.0, 0.0, 1.0), dvec3(0.0, 1.0, 1.0)],
        [dvec3(0.0, 0.0, huge), dvec3(0.0, 0.0, -huge), dvec3(0.0, huge, 0.0)],
    ];
    for corners in points {
        let mut canvas = Canvas::new(View::framing(&FRONT, size, corners).unwrap());
        canvas.faces(&[Face { corners, colour: RED, normal: Some(DVec3::NAN) }]);
        canvas.faces(&[]);
        let image = canvas.finish(&pens());
        let white =
            (0..30).flat_map(|y| (0..40).map(move |x| (x, y))).all(|(x, y)| image.pixel(x, y) == Some(BACKGROUND));
        assert!(white, "{corners:?}");
    }
    let mut canvas = Canvas::new(View::framing(&FRONT, size, []).unwrap());
    assert_eq!(Face::fan(&[], RED, None).count() + Face::fan(&[DVec3::X, DVec3::Y], RED, None).count(), 0);
    // Lines and dots of any kind, and pens of any kind, are taken.
    for p in [DVec3::NAN, DVec3::splat(huge), DVec3::ZERO, DVec3::splat(1e-300)] {
        canvas.line(p, DVec3::X);
        canvas.dot(p);
    }
    canvas.finish(&Pens { fine_width: f64::NAN, fine_strength: f64::INFINITY, bold_width: -3.0, dot_width: huge });
}

#[test]
fn size_and_place_do_not_matter() {
    let size = Size::new(200, 150).unwrap();
    let draw = |scale: f64, shift: f64| {
        let mesh = Shape::Torus.build(800);
        let moved = mesh.positions().iter().map(|&p| p * scale + DVec3::splat(shift)).collect();
        let mesh = TriMesh::new(moved, mesh.facets().to_vec()).unwrap();
        let view = View::framing(&ViewDirection::default(), size, mesh.positions().to_vec()).unwrap();
        draw_mesh((&mesh, None), view, Paint::Quality, &[])
    };
    let one = draw(1.0, 0.0);
    let differ = |other: &Image| {
        let pixels = (0..150).flat_map(|y| (0..200).map(move |x| (x, y)));
        pixels.filter(|&(x, y)| one.pixel(x, y) != other.pixel(x, y)).count()
    };
    // Powers of two change no digit of a coordinate; others move a corner to the next step of the grid now
    // and then, and with it a sample.
    assert_eq!(differ(&draw(2f64.powi(480), 0.0)) + differ(&draw(2f64.powi(-980), 0.0)), 0);
    assert!(differ(&draw(1e149, 0.0)) + differ(&draw(1e-300, 0.0)) + differ(&draw(1.0, 1e6)) < 60);
}

#[test]
fn any_direction_frames_the_surface() {
    let mesh = Shape::Block.build(500);
    for toward in [DVec3::X, DVec3::Y, DVec3::NEG_Y, DVec3::Z, dvec3(1e-300, 0.0, 0.0), dvec3(1e300, -1e300, 3e299)] {
        for up in [DVec3::Y, DVec3::Z, dvec3(-2.0, 1e-9, 0.0)] {
            let look = ViewDirection { toward, up };
            let view = View::framing(&look, Size::new(90, 60).unwrap(), mesh.positions().iter().copied()).unwrap();
            let placed = mesh.positions().iter().map(|&p| view.place(p));
            assert!(placed.clone().all(|p| (2.0..=88.0).contains(&p.x) && (1.0..=59.0).contains(&p.y)), "{look:?}");
            // It fills the width or the height but for the margins.
            let width =
                placed.clone().map(|p| p.x).fold(0.0, f64::max) - placed.clone().map(|p| p.x).fold(90.0, f64::min);
            let height = placed.clone().map(|p| p.y).fold(0.0, f64::max) - placed.map(|p| p.y).fold(60.0, f64::min);
            assert!((width - 0.94 * 90.0).abs() < 1e-6 || (height - 0.94 * 60.0).abs() < 1e-6, "{look:?}");
        }
    }
    for bad in [DVec3::ZERO, DVec3::NAN, DVec3::INFINITY] {
        let look = ViewDirection { toward: bad, up: DVec3::Y };
        assert!(matches!(View::framing(&look, Size::default(), []), Err(PictureError::Direction(_))));
    }
    for (width, height) in [(0, 10), (10, 0), (MAX_SIDE + 1, 1), (MAX_SIDE, MAX_SIDE)] {
        assert!(matches!(Size::new(width, height), Err(PictureError::Size(..))));
    }
}
