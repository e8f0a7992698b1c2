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
    for (name, cameras) in [("a.json", vec![like(), off, portrait]), ("b.npy", vec![like(); 2])] {
        let file = dir.path().join(name);
        write(&file, &cameras, &world(), 12.0).unwrap();
        // What is asked back of a camera that is nothing like those.
        let other = Camera { pose: [[0.0; 4]; 3], ..like() };
        for axes in [Axes::Opengl, Axes::Opencv] {
            let read = read(&file, &other, &world(), axes, None).unwrap();
            assert_alike(&read.cameras, &cameras);
            assert_eq!(read.fps, (name == "a.json").then_some(12.0));
        }
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

/// A `transforms.json` has the axes of its capture. A path and an array have right, up, back, whatever these are.
#[test]
fn frames_have_the_axes_of_their_capture() {
    let dir = tempfile::tempdir().unwrap();
    let matrix = "[[1,0,0,2],[0,-1,0,4],[0,0,-1,6],[0,0,0,1]]";
    let pose = [[1.0, 0.0, 0.0, 2.0], [0.0, -1.0, 0.0, 4.0], [0.0, 0.0, -1.0, 6.0]];
    let ahead = [[1.0, 0.0, 0.0, 2.0], [0.0, 1.0, 0.0, 4.0], [0.0, 0.0, 1.0, 6.0]];
    let frames = file(&dir, "t.json", &format!("{{\"frames\": [{{\"transform_matrix\": {matrix}}}]}}"));
    let path = file(&dir, "p.json", &format!("{{\"camera_path\": [{{\"camera_to_world\": {matrix}}}]}}"));
    let array = dir.path().join("a.npy");
    let world = WorldToScene::default();
    write(&array, &[Camera { pose, ..like() }], &world, 12.0).unwrap();
    let read = |file: &Path, axes: Axes| read(file, &like(), &world, axes, None).unwrap().cameras[0].pose;
    assert_eq!((read(&frames, Axes::Opengl), read(&frames, Axes::Opencv)), (pose, ahead));
    for file in [path, array] {
        assert_eq!((read(&file, Axes::Opengl), read(&file, Axes::Opencv)), (pose, pose));
    }
}

/// By hand: a place (2, 4, 6) of the file under scale 0.5 and a shift.
#[test]
fn places_follow_the_scene_s_transform() {
    let dir = tempfile::tempdir().unwrap();
    let matrix = "[[1,0,0,2],[0,1,0,4],[0,0,1,6],[0,0,0,1]]";
    let shift = [[1.0, 0.0, 0.0, 1.0], [0.0, 1.0, 0.0, 1.0], [0.0, 0.0, 1.0, 1.0]];
    let world = WorldToScene::default().scaled(0.5).moved(&shift);
    let text = format!("{{\"w\": 80, \"h\": 40, \"fl_x\": 100, \"frames\": [{{\"transform_matrix\": {matrix}}}]}}");
    let cameras = read(&file(&dir, "t.json", &text), &like(), &world, Axes::Opengl, None).unwrap().cameras;
    assert_eq!(pose::column(&cameras[0].pose, 3), [2.0, 3.0, 4.0]);
    // The scene's height, the file's aspect and field of view.
    assert_eq!((cameras[0].width, cameras[0].height, cameras[0].focal), (60, 30, [75.0; 2]));
    let flat = "[1,0,0,2, 0,1,0,4, 0,0,1,6, 0,0,0,1]";
    let text = format!(
        "{{\"render_width\": 80, \"render_height\": 40, \"fps\": 24, \"camera_path\": [{{\"camera_to_world\": {flat}, \
         \"fov\": 90}}]}}"
    );
    let read = read(&file(&dir, "p.json", &text), &like(), &world, Axes::Opengl, None).unwrap();
    assert_eq!((read.fps, read.cameras[0].width, read.cameras[0].height), (Some(24.0), 80, 40));
    assert!((read.cameras[0].focal[1] - 20.0).abs() < 1e-12);
    assert_eq!(read.cameras[0].pose, cameras[0].pose);
}

/// nerfstudio: x_ns = scale * transform * x, and the capture is applied_transform * x.
#[test]
fn nerfstudio_s_units_are_undone() {
    let dir = tempfile::tempdir().unwrap();
    let transform = pose::look_along([0.2, 0.7, 0.1], [0.0, 0.1, 1.0], [0.3, -0.6, 0.9]).unwrap();
    let applied = [[1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, -1.0, 0.0, 0.5]];
    let parser =
        file(&dir, "dataparser_transforms.json", &format!("{{\"transform\": {transform:?}, \"scale\": 0.25}}"));
    let transforms = file(&dir, "transforms.json", &format!("{{\"applied_transform\": {applied:?}, \"frames\": []}}"));
    let parser = Dataparser::read(&parser, &transforms).unwrap();
    let original = like().pose;
    let scaled = pose::compose(&transform, &original).map(|[a, b, c, t]| [a, b, c, 0.25 * t]);
    let same = |applied: &Pose, found: Pose| {
        let expected = pose::compose(applied, &original);
        found.iter().flatten().zip(expected.iter().flatten()).all(|(a, b)| (a - b).abs() < 1e-12)
    };
    assert!(same(&applied, parser.to_capture(&scaled)));

    // A folder with COLMAP's model has its axes turned where nothing is said; an applied_scale is refused.
    let named = dir.path().join("dataparser_transforms.json");
    std::fs::create_dir_all(dir.path().join("colmap/sparse/0")).unwrap();
    let transforms = file(&dir, "transforms.json", "{\"frames\": []}");
    let turned = [[0.0, 1.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0], [0.0, 0.0, -1.0, 0.0]];
    assert!(same(&turned, Dataparser::read(&named, &transforms).unwrap().to_capture(&scaled)));
    let transforms = file(&dir, "transforms.json", "{\"applied_scale\": 0.5, \"frames\": []}");
    assert!(Dataparser::read(&named, &transforms).unwrap_err().to_string().contains("applied_scale"));
}

#[test]
fn what_is_no_camera_is_named() {
    let dir = tempfile::tempdir().unwrap();
    let flat = "[1,0,0,2, 0,1,0,4, 0,0,1,6, 0,0,0,1]";
    for (name, text, words) in [
        ("a.txt", "", ".npy"),
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
        ("a.npy", "text", "NUMPY"),
    ] {
        let error = read(&file(&dir, name, text), &like(), &world(), Axes::Opengl, None).unwrap_err().to_string();
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
        let said = read(&file, &like(), &world(), Axes::Opengl, None).unwrap_err().to_string();
        assert!(said.contains(word), "{said}");
    }
}
