use std::path::PathBuf;

use super::*;

fn like() -> Camera {
    let pose = pose::look_along([0.3, -0.5, 0.9], [0.1, 1.0, 0.2], [1.0, 2.0, -3.0]).unwrap();
    Camera { width: 40, height: 30, focal: [35.0, 35.0], centre: [20.0, 15.0], pose }
}

fn world() -> WorldToScene {
    let motion = pose::look_along([-0.3, 0.5, 0.2], [0.1, 0.0, 1.0], [0.5, -1.0, 0.25]).unwrap();
    WorldToScene::default().scaled(0.4).moved(&motion)
}

fn file(dir: &tempfile::TempDir, name: &str, text: &str) -> PathBuf {
    let file = dir.path().join(name);
    std::fs::write(&file, text).unwrap();
    file
}

fn assert_alike(found: &[Camera], expected: &[Camera]) {
    assert_eq!(found.len(), expected.len());
    for (a, b) in found.iter().zip(expected) {
        assert_eq!((a.width, a.height), (b.width, b.height));
        let numbers =
            |c: &Camera| c.focal.iter().chain(&c.centre).chain(c.pose.iter().flatten()).copied().collect::<Vec<f64>>();
        for (a, b) in numbers(a).iter().zip(numbers(b)) {
            assert!((a - b).abs() < 1e-9, "{found:?} {expected:?}");
        }
    }
}

#[test]
fn what_is_written_is_read_back() {
    let dir = tempfile::tempdir().unwrap();
    let off = Camera { focal: [33.0, 31.0], centre: [19.0, 16.5], ..like() };
    let portrait = Camera { width: 30, height: 40, centre: [15.0, 20.0], ..like() };
    let (file, cameras) = (dir.path().join("a.json"), [like(), off, portrait]);
    write(&file, &cameras, &world(), 12.0).unwrap();
    // What is asked back of a camera that is nothing like those.
    let other = Camera { pose: [[0.0; 4]; 3], ..like() };
    for axes in [Axes::Opengl, Axes::Opencv] {
        let read = read(&file, &other, &world(), axes).unwrap();
        assert_alike(&read.cameras, &cameras);
        assert_eq!(read.fps, Some(12.0));
    }
}

/// A camera of a written path is a request of `render --serve`.
#[test]
fn what_is_written_can_be_asked_for() {
    let off = Camera { focal: [33.0, 31.0], centre: [19.0, 16.5], ..like() };
    let text = camera_path(&[off], &world(), 12.0)["camera_path"][0].to_string();
    let other = Camera { pose: [[0.0; 4]; 3], ..like() };
    let (camera, others) = parse_camera("request 0", text.as_bytes(), &other, &world()).unwrap();
    assert_alike(&[camera], &[off]);
    assert!(others.is_empty(), "{others:?}");
}

/// A `transforms.json` has the axes of its capture. A path has right, up, back, whatever these are.
#[test]
fn frames_have_the_axes_of_their_capture() {
    let dir = tempfile::tempdir().unwrap();
    let matrix = "[[1,0,0,2],[0,-1,0,4],[0,0,-1,6],[0,0,0,1]]";
    let pose = [[1.0, 0.0, 0.0, 2.0], [0.0, -1.0, 0.0, 4.0], [0.0, 0.0, -1.0, 6.0]];
    let ahead = [[1.0, 0.0, 0.0, 2.0], [0.0, 1.0, 0.0, 4.0], [0.0, 0.0, 1.0, 6.0]];
    let frames = file(&dir, "t.json", &format!("{{\"frames\": [{{\"transform_matrix\": {matrix}}}]}}"));
    let path = file(&dir, "p.json", &format!("{{\"camera_path\": [{{\"camera_to_world\": {matrix}}}]}}"));
    let world = WorldToScene::default();
    let read = |file: &Path, axes: Axes| read(file, &like(), &world, axes).unwrap().cameras[0].pose;
    assert_eq!((read(&frames, Axes::Opengl), read(&frames, Axes::Opencv)), (pose, ahead));
    assert_eq!((read(&path, Axes::Opengl), read(&path, Axes::Opencv)), (pose, pose));
}

/// By hand: a place (2, 4, 6) of the file under scale 0.5 and a shift.
#[test]
fn places_follow_the_scene_s_transform() {
    let dir = tempfile::tempdir().unwrap();
    let matrix = "[[1,0,0,2],[0,1,0,4],[0,0,1,6],[0,0,0,1]]";
    let shift = [[1.0, 0.0, 0.0, 1.0], [0.0, 1.0, 0.0, 1.0], [0.0, 0.0, 1.0, 1.0]];
    let world = WorldToScene::default().scaled(0.5).moved(&shift);
    let text = format!("{{\"w\": 80, \"h\": 40, \"fl_x\": 100, \"frames\": [{{\"transform_matrix\": {matrix}}}]}}");
    let cameras = read(&file(&dir, "t.json", &text), &like(), &world, Axes::Opengl).unwrap().cameras;
    assert_eq!(pose::column(&cameras[0].pose, 3), [2.0, 3.0, 4.0]);
    // The scene's height, the file's aspect and field of view.
    assert_eq!((cameras[0].width, cameras[0].height, cameras[0].focal), (60, 30, [75.0; 2]));
    let flat = "[1,0,0,2, 0,1,0,4, 0,0,1,6, 0,0,0,1]";
    let text = format!(
        "{{\"render_width\": 80, \"render_height\": 40, \"fps\": 24, \"camera_path\": [{{\"camera_to_world\": {flat}, \
         \"fov\": 90}}]}}"
    );
    let read = read(&file(&dir, "p.json", &text), &like(), &world, Axes::Opengl).unwrap();
    assert_eq!((read.fps, read.cameras[0].width, read.cameras[0].height), (Some(24.0), 80, 40));
    assert!((read.cameras[0].focal[1] - 20.0).abs() < 1e-12);
    assert_eq!(read.cameras[0].pose, cameras[0].pose);
}

/// As in training: an angle in y does not count beside a focal length in x.
#[test]
fn a_focal_length_in_x_is_that_in_y_too() {
    let dir = tempfile::tempdir().unwrap();
    let frame = "\"frames\": [{\"transform_matrix\": [[1,0,0,2],[0,1,0,4],[0,0,1,6],[0,0,0,1]]}]";
    for (keys, x, y) in [
        ("\"fl_x\": 100, \"camera_angle_y\": 0.5", 75.0, 75.0),
        ("\"fl_x\": 100, \"fl_y\": 120, \"camera_angle_y\": 0.5", 75.0, 90.0),
        ("\"fl_y\": 120", 90.0, 90.0),
    ] {
        let text = format!("{{\"w\": 80, \"h\": 40, {keys}, {frame}}}");
        let cameras = read(&file(&dir, "t.json", &text), &like(), &world(), Axes::Opengl).unwrap().cameras;
        assert_eq!(cameras[0].focal, [x, y], "{keys}");
    }
}

#[test]
fn what_is_no_camera_is_named() {
    let dir = tempfile::tempdir().unwrap();
    let flat = "[1,0,0,2, 0,1,0,4, 0,0,1,6, 0,0,0,1]";
    for (name, text, words) in [
        ("a.npy", "", "ends in .json"),
        ("a.json", "{}", "camera_path"),
        ("a.json", "{\"camera_path\": []}", "empty"),
        ("a.json", "{\"camera_path\": [{\"fov\": 50}]}", "camera_to_world"),
        ("a.json", "{\"camera_path\": [{\"camera_to_world\": [1, 2]}]}", "16 numbers"),
        ("a.json", "{\"camera_path\": [{\"camera_to_world\": [2,0,0,2, 0,1,0,4, 0,0,1,6, 0,0,0,1]}]}", "rotation"),
        ("a.json", &format!("{{\"camera_path\": [{{\"camera_to_world\": {flat}, \"fov\": 200}}]}}"), "180"),
        ("a.json", "{\"camera_type\": \"fisheye\", \"camera_path\": [{}]}", "fisheye"),
        ("a.json", "{\"fps\": 0, \"camera_path\": [{}]}", "fps"),
        ("a.json", &format!("{{\"render_width\": 1e6, \"camera_path\": [{{\"camera_to_world\": {flat}}}]}}"), "16384"),
        ("a.json", "{\"fl_x\": 9, \"frames\": [{}]}", "\"w\""),
    ] {
        let error = read(&file(&dir, name, text), &like(), &world(), Axes::Opengl).unwrap_err().to_string();
        assert!(error.contains(words) && error.contains(name), "{text}: {error}");
    }
}

#[test]
fn fisheye_cameras_are_refused() {
    let dir = tempfile::tempdir().unwrap();
    let frame = "\"frames\": [{\"transform_matrix\": [[1,0,0,2],[0,1,0,4],[0,0,1,6],[0,0,0,1]]}]";
    for (key, word) in
        [("\"camera_model\": \"OPENCV_FISHEYE\"", "OPENCV_FISHEYE"), ("\"is_fisheye\": true", "is_fisheye")]
    {
        let file = file(&dir, "t.json", &format!("{{{key}, {frame}}}"));
        let said = read(&file, &like(), &world(), Axes::Opengl).unwrap_err().to_string();
        assert!(said.contains(word), "{said}");
    }
}
