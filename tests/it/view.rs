//! The page of runs: its server over HTTP, as a browser speaks to it.

use std::io::{BufRead, BufReader, Read, Write};
use std::net::{Ipv4Addr, TcpStream};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;

use augnerf::base::Image;
use augnerf::data::cameras;
use augnerf::methods::FieldRenderer;
use augnerf::render::ray_parts;
use augnerf::run::{RunDir, Viewer};
use augnerf::runtime::Runtime;
use augnerf::settings::{Axes, Config, Encoding, Method};
use augnerf::view::{Attack, PerturbedRenderer, Server, ShownRun, SkippingRenderer};
use candle_core::DType;

use crate::common::program::{Place, set};
use crate::common::{runtime, tiny_config, tiny_scene, trained};

/// A run of the soft ball after some steps.
pub fn shown(label: &str, method: Method, steps: u64) -> Arc<ShownRun> {
    shown_with(label, method, steps, |_| {})
}

pub fn shown_with(label: &str, method: Method, steps: u64, change: impl FnOnce(&mut Config)) -> Arc<ShownRun> {
    let config = tiny_config(method, |config| {
        config.train.steps = steps.max(1);
        change(config);
    });
    let trainer = trained(&config, steps);
    let run = ShownRun::of_training(label.into(), config, tiny_scene(), Runtime::new("cpu", Some(2)).unwrap());
    run.show_copy(steps, trainer.model().unwrap()).unwrap();
    Arc::new(run)
}

/// An answer of the server.
pub struct Reply {
    pub status: u16,
    head: String,
    body: Vec<u8>,
}

impl Reply {
    fn words(&self) -> String {
        String::from_utf8_lossy(&self.body).into_owned()
    }

    pub fn json(&self) -> serde_json::Value {
        serde_json::from_slice(&self.body).unwrap()
    }

    fn size(&self) -> (u32, u32) {
        let image = image::load_from_memory(&self.body).unwrap();
        (image.width(), image.height())
    }
}

/// Asks for an address, with further header lines.
pub fn ask(method: &str, url: &str, headers: &str, body: &str) -> Reply {
    let (host, path) = url.strip_prefix("http://").unwrap().split_once('/').unwrap();
    let mut stream = TcpStream::connect(host).unwrap();
    let length = body.len();
    let head = format!("Host: {host}\r\nConnection: close\r\nContent-Length: {length}\r\n{headers}");
    write!(stream, "{method} /{path} HTTP/1.1\r\n{head}\r\n{body}").unwrap();
    // A driver of browsers leaves the connection open.
    stream.set_read_timeout(Some(Duration::from_secs(60))).unwrap();
    let mut reader = BufReader::new(stream);
    let mut head = String::new();
    while reader.read_line(&mut head).unwrap() > 2 {}
    let lower = head.to_lowercase();
    let mut body = Vec::new();
    match lower.split_once("content-length:").and_then(|(_, rest)| rest.lines().next()?.trim().parse::<u64>().ok()) {
        Some(length) => reader.take(length).read_to_end(&mut body).unwrap(),
        None => reader.read_to_end(&mut body).unwrap(),
    };
    let head = head.trim_end().to_string();
    Reply { status: head.split(' ').nth(1).unwrap().parse().unwrap(), head, body }
}

pub fn get(url: &str) -> Reply {
    ask("GET", url, "", "")
}

/// Does `work` with the page of some runs, at the address that it gets.
pub fn served<T>(runs: Vec<Arc<ShownRun>>, work: impl FnOnce(&str, &Server) -> T) -> T {
    let server = Arc::new(Server::bind(runs, (Ipv4Addr::LOCALHOST, 0).into()).unwrap());
    let stop = AtomicUsize::new(0);
    std::thread::scope(|scope| {
        scope.spawn(|| server.serve(&stop));
        let done = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| work(&server.url(), &server)));
        stop.store(1, Ordering::SeqCst);
        done.unwrap_or_else(|failed| std::panic::resume_unwind(failed))
    })
}

const VIEW: &str = "run=0&view=held-out:0&width=16&height=16";

#[test]
fn the_page_has_all_that_it_loads_and_nothing_from_elsewhere() {
    served(vec![shown("a", Method::Nerf, 0)], |url, _| {
        let page = get(url);
        assert_eq!(page.status, 200);
        assert!(page.head.contains("default-src 'none'") && page.head.contains("no-referrer"), "{}", page.head);
        for file in ["viewer.js", "viewer.css", "icon.svg"] {
            assert!(page.words().contains(file));
            let file = get(&format!("{url}{file}"));
            assert_eq!(file.status, 200);
            assert!(!file.words().replace("http://www.w3.org/2000/svg", "").contains("http"));
        }
        let others = [get(&format!("{url}other")), ask("PUT", url, "", ""), get(url.trim_end_matches('/'))];
        assert_eq!(others.map(|reply| reply.status), [404, 405, 301]);
    });
}

#[test]
fn without_its_token_or_from_another_page_nothing_is_answered() {
    served(vec![shown("a", Method::Nerf, 0)], |url, server| {
        let (place, token) = url.trim_end_matches('/').rsplit_once('/').unwrap();
        assert_eq!(token.len(), 32);
        for wrong in ["", &format!("{}/state", "0".repeat(32)), &format!("{}/", &token[1..])] {
            let reply = get(&format!("{place}/{wrong}"));
            assert!(reply.status == 403 && reply.words().contains("token"), "{wrong}");
        }
        let state = format!("{url}state");
        assert_eq!(ask("GET", &state, "Origin: http://example.org\r\n", "").status, 403);
        // A proxy may end TLS.
        for own in [place.to_string(), place.replace("http:", "https:")] {
            assert_eq!(ask("GET", &state, &format!("Origin: {own}\r\n"), "").status, 200, "{own}");
        }
        assert!(!server.is_public());
    });
}

/// Opens a connection and sends some bytes.
fn sent(place: &str, bytes: &[u8]) -> TcpStream {
    let mut stream = TcpStream::connect(place.strip_prefix("http://").unwrap()).unwrap();
    stream.set_read_timeout(Some(Duration::from_secs(60))).unwrap();
    stream.write_all(bytes).unwrap();
    stream
}

/// The address without the token.
fn place_of(url: &str) -> &str {
    url.trim_end_matches('/').rsplit_once('/').unwrap().0
}

/// What comes without the token is refused before its body, and what is no request is refused, each in words. With the token
/// bodies have a limit.
#[test]
fn what_is_no_request_of_the_page_is_refused_and_its_connection_closed() {
    served(vec![shown("a", Method::Nerf, 0)], |url, _| {
        let place = place_of(url);
        let token = url.rsplit('/').nth(1).unwrap();
        let of_page = |lines: &str| format!("POST /{token}/path HTTP/1.1\r\n{lines}\r\n\r\n");
        let stranger = |lines: &str| format!("POST / HTTP/1.1\r\n{lines}\r\n\r\n");
        for (bytes, status, words) in [
            (stranger("Content-Length: 1"), 403, "token"),
            (stranger("Content-Length: 4611686018427387904"), 403, "token"),
            (stranger("Transfer-Encoding: chunked"), 403, "token"),
            (of_page("Content-Length: 5000000"), 413, "too long"),
            (of_page("Transfer-Encoding: chunked"), 413, "too long"),
            (of_page(&"a: b\r\n".repeat(200)), 431, "too many"),
            ("GET / HTTP/9.9\r\n\r\n".into(), 400, "no request"),
        ] {
            let answer = std::io::read_to_string(sent(place, bytes.as_bytes())).unwrap();
            let start = &bytes[..bytes.len().min(60)];
            assert!(answer.starts_with(&format!("HTTP/1.1 {status} ")) && answer.contains(words), "{start}: {answer}");
            assert!(answer.contains("Connection: close"), "{start}: {answer}");
        }
        assert_eq!(get(url).status, 200);
    });
}

#[test]
fn pictures_are_those_of_render_and_every_layer_is_drawn() {
    let run = shown("a", Method::Nerf, 40);
    served(vec![run.clone()], |url, _| {
        let picture = get(&format!("{url}picture?{VIEW}&page=x&turn=1"));
        assert_eq!((picture.status, picture.size()), (200, (16, 16)));
        let weights = run.weights().unwrap();
        let viewer = Viewer { model: &weights.model, config: &run.config, scene: &run.scene, runtime: &run.runtime };
        let Image { pixels, .. } = viewer.render(&run.scene.test[0].camera).unwrap().image;
        let shown = image::load_from_memory(&picture.body).unwrap().to_rgb8();
        let error: f64 =
            shown.as_raw().iter().zip(&pixels).map(|(a, b)| (f64::from(*a) / 255.0 - f64::from(*b)).abs()).sum();
        assert!(error / (pixels.len() as f64) < 1.0 / 255.0);
        for layer in ["depth", "accumulation", "normals"] {
            let reply = get(&format!("{url}picture?{VIEW}&page=x&turn=2&layer={layer}"));
            assert_eq!((reply.status, reply.size()), (200, (16, 16)), "{}", reply.words());
            assert_ne!(reply.body, picture.body);
        }
        let moving = get(&format!("{url}picture?{VIEW}&page=x&turn=3&moving=1"));
        assert!(moving.head.contains("image/jpeg"));
        let photograph = get(&format!("{url}photograph?view=train:2"));
        assert_eq!((photograph.status, photograph.size()), (200, (16, 16)));
    });
}

#[test]
fn what_is_out_of_range_is_refused_in_words() {
    served(vec![shown("a", Method::Nerf, 0)], |url, _| {
        let level = "pose=1,0,0,0,0,1,0,0,0,0,1,4&fov=40&width=16&height=16";
        for (query, words) in [
            ("run=0&page=x&turn=1&view=held-out:0&width=5000&height=16", "8 to 4096"),
            ("run=0&page=x&turn=1&view=held-out:0&width=4000&height=4000", "at most"),
            ("run=0&page=x&turn=1&view=held-out:7&width=16&height=16", "1 held-out views"),
            (&format!("run=0&page=x&turn=1&layer=smell&{level}"), "normals"),
            (&format!("run=0&page=x;&turn=1&{level}"), "letters"),
            (&format!("run=0&page=x&{level}"), "turn is missing"),
        ] {
            let reply = get(&format!("{url}picture?{query}"));
            assert_eq!(reply.status, 400, "{query}");
            assert!(reply.words().contains(words), "{query}: {}", reply.words());
        }
        let reply = get(&format!("{url}ray?{VIEW}&page=x&turn=1&x=16&y=0"));
        assert!(reply.status == 400 && reply.words().contains("outside"), "{}", reply.words());
    });
}

/// An older request of a page's slot gives way; another page's does not.
#[test]
fn the_newest_picture_of_a_page_wins() {
    served(vec![shown("a", Method::Nerf, 0)], |url, _| {
        let at = |page: &str, turn: u64| get(&format!("{url}picture?{VIEW}&page={page}&turn={turn}")).status;
        assert_eq!((at("x", 5), at("x", 4), at("y", 1), at("x", 5)), (200, 409, 200, 200));
    });
}

/// A picture without a reader is given up, whether it is being made or waits.
#[test]
fn a_closed_page_ends_its_pictures_and_holds_nobody_up() {
    let run = shown("a", Method::Nerf, 0);
    served(vec![run.clone()], |url, server| {
        let before = run.runtime.work().multiply_adds;
        assert_eq!(get(&format!("{url}picture?{VIEW}&page=x&turn=1")).status, 200);
        let of_small = run.runtime.work().multiply_adds - before;
        let token = url.rsplit('/').nth(1).unwrap();
        // Pixels of a picture that takes long.
        let [width, height] = [4096u32, 1024];
        let pages: Vec<TcpStream> = ["a", "b"]
            .map(|page| {
                let query = format!("run=0&view=held-out:0&width={width}&height={height}&page={page}&turn=1");
                sent(place_of(url), format!("GET /{token}/picture?{query} HTTP/1.1\r\n\r\n").as_bytes())
            })
            .into();
        let until = |unfinished: usize| {
            while server.unfinished() != unfinished {
                std::thread::sleep(Duration::from_millis(1));
            }
        };
        until(2);
        // Who wants a small picture quickly, or a ray, does not wait for them.
        assert_eq!(get(&format!("{url}picture?{VIEW}&page=c&turn=1&within=1000")).status, 200);
        assert_eq!(get(&format!("{url}ray?{VIEW}&page=c-ray&turn=1&x=1&y=1")).status, 200);
        assert_eq!(server.unfinished(), 2, "they were waited for");
        drop(pages);
        until(0);
        let whole = of_small / 256 * u64::from(width * height);
        let done = run.runtime.work().multiply_adds - before;
        assert!(done < whole, "{done} multiply-adds for dead pages, of {whole} for one picture");
        assert_eq!(get(&format!("{url}picture?{VIEW}&page=d&turn=1")).status, 200);
    });
}

#[test]
fn a_recorded_path_is_what_render_reads() {
    let run = shown("a", Method::Nerf, 0);
    served(vec![run.clone()], |url, _| {
        let poses = "[[[1,0,0,0.5],[0,1,0,0],[0,0,1,4]],[[1,0,0,0],[0,1,0,0.25],[0,0,1,3]]]";
        let address = format!("{url}path?view=held-out:0&width=32&height=24&fps=15");
        let reply = ask("POST", &address, "", poses);
        assert_eq!(reply.status, 200, "{}", reply.words());
        let dir = tempfile::tempdir().unwrap();
        let file = dir.path().join("camera_path.json");
        std::fs::write(&file, &reply.body).unwrap();
        let read = cameras::read(&file, &run.scene.test[0].camera, &run.scene.space.world, Axes::Opengl).unwrap();
        assert_eq!((read.cameras.len(), read.fps), (2, Some(15.0)));
        let first = read.cameras[0];
        assert_eq!((first.width, first.height, first.pose[0][3]), (32, 24, 0.5));
        for wrong in ["[]", "[[1,2]]", "no"] {
            assert_eq!(ask("POST", &address, "", wrong).status, 400);
        }
    });
}

/// A run is shown while it trains, and who has recorded a path renders it while the page is open.
#[test]
fn a_shown_run_is_free_for_other_commands() {
    let place = Place::trained(&set("data.width=16 train.rays=64 train.steps=40 eval.pictures=0"));
    let out = place.at("run");
    let training = RunDir::take(&out).unwrap();
    let run = ShownRun::open(&out, None, &Runtime::new("cpu", Some(1)).unwrap(), &()).unwrap();
    drop(training);
    place.run("eval --quiet run", 0);
    assert_eq!(run.weights().unwrap().step, 40);
}

#[test]
fn deltas_of_no_size_are_the_clean_pass_and_others_raise_the_error() {
    let run = shown("a", Method::AugNerf, 60);
    let weights = run.weights().unwrap();
    let perturbed = weights.perturbed.as_ref().unwrap();
    let sites: Vec<String> = perturbed.sites().iter().map(|site| site.to_string()).collect();
    assert_eq!(sites, ["t", "xyz", "view", "feature", "rgb", "density"]);
    let view = &run.scene.test[0];
    let pixels: Vec<_> = (0..256u32).map(|i| (&view.camera, i % 16, i / 16)).collect();
    let origin = run.config.data.origin_of_pixels();
    let rays = augnerf::data::RayBuffer::new(&pixels, None, origin, perturbed.ray_parts())
        .to_tensors(DType::F32, run.runtime.device())
        .unwrap();
    let target = candle_core::Tensor::from_slice(&view.image.pixels, (256, 3), run.runtime.device()).unwrap();
    let error = |attack: &Attack| {
        let rgb = perturbed.pass(&rays, Some(&target), attack, 0).unwrap().composite.rgb;
        (&rgb - &target).unwrap().sqr().unwrap().mean_all().unwrap().to_scalar::<f32>().unwrap()
    };
    let clean = error(&Attack { sites: vec![], scale: 1.0 });
    assert_eq!(error(&Attack { sites: sites.clone(), scale: 0.0 }), clean);
    let once = error(&Attack { sites: sites.clone(), scale: 1.0 });
    assert!(once > clean && error(&Attack { sites, scale: 3.0 }) > once);
    // The same picture each time.
    served(vec![run], |url, _| {
        let at = |turn: u64, sites: &str| get(&format!("{url}picture?{VIEW}&page=x&turn={turn}&sites={sites}"));
        let (a, b) = (at(1, "xyz,rgb"), at(2, "xyz,rgb"));
        assert!(a.status == 200 && a.body == b.body && a.body != at(3, "").body);
        let ray = get(&format!("{url}ray?{VIEW}&page=x-ray&turn=1&x=8&y=8&sites=density")).json();
        let samples = |key: &str| ray["clean"][key].as_array().unwrap().len();
        assert_eq!((samples("t"), samples("weights"), samples("rgb")), (16, 16, 16));
        let sum: f64 = ray["clean"]["weights"].as_array().unwrap().iter().map(|weight| weight.as_f64().unwrap()).sum();
        assert!((0.0..1.0001).contains(&sum) && ray["attacked"]["pixel"] != ray["clean"]["pixel"]);
    });
}

#[test]
fn runs_of_two_scenes_have_no_page() {
    let (a, b) = (shown("a", Method::Nerf, 0), shown("b", Method::Nerf, 0));
    served(vec![a.clone(), b], |url, _| {
        let state = get(&format!("{url}state")).json();
        assert_eq!((state["runs"][0]["label"].as_str(), state["runs"][1]["label"].as_str()), (Some("a"), Some("b")));
    });
    let mut other = tiny_scene();
    other.train.iter_mut().chain(&mut other.test).for_each(|view| view.camera.pose[0][3] += 1.0);
    let other = Arc::new(ShownRun::of_training("c".into(), a.config.clone(), other, a.runtime.clone()));
    let refusal = Server::bind(vec![a, other], (Ipv4Addr::LOCALHOST, 0).into()).err().unwrap().to_string();
    assert!(refusal.contains("different scenes"), "{refusal}");
}

/// On a hash grid and on networks: without empty space left out the pictures are the same, and with a little they hardly
/// differ.
#[test]
fn pictures_without_empty_space_are_those_with_it() {
    let (scene, runtime) = (tiny_scene(), runtime());
    for encoding in [Encoding::Hash, Encoding::Positional] {
        let config = tiny_config(Method::Nerf, |config| {
            config.field.encoding = encoding;
            config.train.steps = 150;
        });
        let trainer = trained(&config, 150);
        let model = trainer.model().unwrap();
        let fields = model.fields().unwrap();
        let viewer = Viewer { model, config: &config, scene: &scene, runtime };
        let full = FieldRenderer::new(fields, &config, &scene).unwrap();
        let mut skipping = SkippingRenderer::new(fields, &config, &scene, runtime, &mut || Ok(())).unwrap().unwrap();
        let camera = scene.test[0].camera;
        let expected = viewer.render_with(&full, &camera).unwrap().image.pixels;
        let mut differences = Vec::new();
        for least_alpha in [0.0, 1e-3, 0.5] {
            skipping.set_least_alpha(least_alpha);
            let found = viewer.render_with(&skipping, &camera).unwrap().image.pixels;
            let most = found.iter().zip(&expected).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
            differences.push((most, skipping.occupied()));
        }
        let [(same, all), (close, some), (far, few)] = differences[..] else { unreachable!() };
        assert!(same < 1e-5 && all == 1.0, "{encoding:?}: {differences:?}");
        assert!(close < 0.02 && far > close && few < some, "{encoding:?}: {differences:?}");
    }
    let mip = tiny_config(Method::MipNerf, |_| {});
    let trainer = trained(&mip, 0);
    let fields = trainer.model().unwrap().fields().unwrap();
    assert!(SkippingRenderer::new(fields, &mip, &scene, runtime, &mut || Ok(())).unwrap().is_none());
    assert!(ray_parts(fields.evaluated()).footprint);
    assert!(PerturbedRenderer::new(fields, &mip, &scene).unwrap().ray_parts().footprint);
}
