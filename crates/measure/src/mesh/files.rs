//! Mesh files: PLY (binary written, any read) and OBJ.

use std::io::{BufRead, BufReader, Read, Write};
use std::path::Path;

use serde::Deserialize;
use serde_ply::{DeserializeError, ElementDef, PlyReader};

use augnerf_base::input::open_regular;
use augnerf_base::{Error, Result};
use augnerf_scenes::ply;
use augnerf_scenes::vector::add;

use super::triangles::{Mesh, with_origin};

/// Longest line of an OBJ file: a polygon of a million corners.
const MOST_LINE: u64 = 1 << 24;

#[derive(Deserialize)]
struct PlyVertex {
    x: f64,
    y: f64,
    z: f64,
}

#[derive(Deserialize)]
struct PlyFace {
    #[serde(alias = "vertex_index")]
    vertex_indices: Vec<i64>,
}

/// A row of an element that does not describe the surface.
#[derive(Deserialize)]
struct PlyOther {}

/// The word of the comment with a mesh's origin, which other programs do not add.
const OFFSET: &str = "offset";

/// Returns a file's comment: `comment`, and a line with the origin if the mesh has one.
fn with_offset(comment: &str, mesh: &Mesh) -> String {
    let [x, y, z] = mesh.origin;
    if mesh.origin == [0.0; 3] { comment.into() } else { format!("{comment}\n{OFFSET} {x} {y} {z}") }
}

/// Returns the origin in a comment, if it is such a line.
fn offset_of(comment: &str) -> Option<[f64; 3]> {
    let numbers = comment.trim().strip_prefix(OFFSET)?.split_whitespace().map(|word| word.parse().ok());
    numbers.collect::<Option<Vec<f64>>>()?.try_into().ok()
}

/// Writes binary little-endian PLY, with normals and colours if the mesh has them. Positions are less the origin, which a
/// comment tells: few programs keep doubles.
pub fn write_ply(mesh: &Mesh, comment: &str, out: &mut impl Write) -> std::io::Result<()> {
    let Mesh { vertices, normals, colours, triangles, .. } = mesh;
    ply::Surface { vertices, normals, colours, triangles }.write_ply(&with_offset(comment, mesh), out)
}

/// Writes OBJ. Colours follow the positions, as most programs read them. Positions are less the origin, as in [`write_ply`].
pub fn write_obj(mesh: &Mesh, comment: &str, out: &mut impl Write) -> std::io::Result<()> {
    with_offset(comment, mesh).lines().try_for_each(|line| writeln!(out, "# {line}"))?;
    for (index, [x, y, z]) in mesh.vertices.iter().enumerate() {
        match mesh.colours.get(index).map(|rgb| rgb.map(|v| f32::from(v) / 255.0)) {
            Some([r, g, b]) => writeln!(out, "v {x} {y} {z} {r} {g} {b}")?,
            None => writeln!(out, "v {x} {y} {z}")?,
        }
    }
    mesh.normals.iter().try_for_each(|[x, y, z]| writeln!(out, "vn {x} {y} {z}"))?;
    for [a, b, c] in mesh.triangles.iter().map(|triangle| triangle.map(|i| i + 1)) {
        match mesh.normals.is_empty() {
            true => writeln!(out, "f {a} {b} {c}")?,
            false => writeln!(out, "f {a}//{a} {b}//{b} {c}//{c}")?,
        }
    }
    Ok(())
}

/// Reads positions and faces of a `.ply` (ascii or binary) or `.obj` file. Polygons are cut into triangles from their
/// first corner. Positions far from 0 are less an [origin](Mesh::origin), which files of this program name.
///
/// # Errors
/// The file cannot be read. The mesh has no faces or no area, or a coordinate is NaN.
///
/// ```
/// # mod augnerf { pub use {augnerf_base as base, augnerf_measure::mesh}; }
/// use augnerf::mesh::read_mesh;
///
/// let folder = tempfile::tempdir().unwrap();
/// let file = folder.path().join("triangle.obj");
/// std::fs::write(&file, "v 0 0 0\nv 1 0 0\nv 0 2 0\nf 1 2 3\n").unwrap();
/// let mesh = read_mesh(&file)?;
/// assert_eq!((mesh.triangles.len(), mesh.area()), (1, 1.0));
/// # Ok::<(), augnerf::base::Error>(())
/// ```
pub fn read_mesh(path: &Path) -> Result<Mesh> {
    let fail = |what: String| Error::Data(format!("{}: {what}", path.display()));
    let file = open_regular(path).map_err(|e| Error::unreadable(path, &e))?;
    let ending = path.extension().map(|e| e.to_string_lossy().to_ascii_lowercase()).unwrap_or_default();
    let read = match ending.as_str() {
        "ply" => read_ply,
        "obj" => read_obj,
        _ => return Err(fail("its name does not end in .ply or .obj; name a mesh in one of these formats".into())),
    };
    let mesh = read(&mut BufReader::new(file)).map_err(fail)?;
    if let Some(at) = mesh.vertices.iter().position(|v| v.iter().any(|v| !v.is_finite())) {
        return Err(fail(format!("vertex {at} is {:?}: every coordinate must be a number", mesh.vertices[at])));
    }
    if mesh.triangles.is_empty() {
        return Err(fail(format!(
            "the mesh has {} vertices and no faces: name a mesh with faces, not a point cloud",
            mesh.vertices.len()
        )));
    }
    if mesh.area() <= 0.0 {
        return Err(fail(format!(
            "its faces have no area (triangles: {}); name a mesh with a surface",
            mesh.triangles.len()
        )));
    }
    Ok(mesh)
}

fn read_ply(file: &mut BufReader<std::fs::File>) -> std::result::Result<Mesh, String> {
    let (offset, vertices, faces) = ply_elements(file)
        .map_err(|e| format!("cannot be read as PLY: {}; vertices need x, y, z, faces a list vertex_indices", e.0))?;
    let vertices: Vec<[f64; 3]> = vertices.iter().map(|v| [v.x, v.y, v.z]).collect();
    let mut triangles = Vec::with_capacity(faces.len());
    for (number, face) in faces.iter().enumerate() {
        let indices: Option<Vec<u32>> = face.vertex_indices.iter().map(|&i| u32::try_from(i).ok()).collect();
        let indices = indices.filter(|indices| indices.iter().all(|&i| (i as usize) < vertices.len()));
        let indices = indices.ok_or_else(|| {
            let count = vertices.len();
            format!("face {number} names the vertices {:?}, but there are {count}, counted from 0", face.vertex_indices)
        })?;
        triangles.extend(fan(&indices));
    }
    Ok(placed(&vertices, triangles, offset))
}

/// Returns the mesh of a file's positions and offset.
fn placed(positions: &[[f64; 3]], triangles: Vec<[u32; 3]>, offset: Option<[f64; 3]>) -> Mesh {
    let (vertices, origin) = with_origin(positions);
    Mesh { vertices, origin: add(origin, offset.unwrap_or_default()), triangles, ..Mesh::default() }
}

/// Offset, vertices and faces.
type PlyContent = (Option<[f64; 3]>, Vec<PlyVertex>, Vec<PlyFace>);

fn ply_elements(file: &mut BufReader<std::fs::File>) -> std::result::Result<PlyContent, DeserializeError> {
    let bytes = file.get_ref().metadata()?.len();
    let (mut vertices, mut faces) = (Vec::new(), Vec::new());
    // The reader needs an end of line after the last number of a text file.
    let mut reader = PlyReader::from_reader(file.chain(&b"\n"[..]))?;
    let offset = reader.header().comments.iter().find_map(|comment| offset_of(comment));
    while let Some(element) = reader.current_element() {
        check_rows(element, bytes)?;
        match element.name.as_str() {
            "vertex" => vertices = reader.next_element()?,
            "face" => faces = reader.next_element()?,
            _ => drop(reader.next_element::<Vec<PlyOther>>()?),
        }
    }
    Ok((offset, vertices, faces))
}

/// Every row has at least one byte per property. Rows without properties take none, and would be counted without end.
fn check_rows(element: &ElementDef, bytes: u64) -> std::io::Result<()> {
    let least = (element.count as u64).checked_mul(element.properties.len() as u64);
    if element.count == 0 || least.is_some_and(|least| (1..=bytes).contains(&least)) {
        return Ok(());
    }
    let (name, count, properties) = (&element.name, element.count, element.properties.len());
    Err(std::io::Error::other(format!("{count} rows of {properties} properties ('{name}') in a file of {bytes} bytes")))
}

/// Reads `v` and `f`, which describe the complete shape. Readers of the full format reject files for other content,
/// such as half-given colours or texture coordinates, and read polylines as faces.
fn read_obj(file: &mut BufReader<std::fs::File>) -> std::result::Result<Mesh, String> {
    let (mut vertices, mut triangles, mut offset) = (Vec::new(), Vec::new(), None);
    let mut bytes = Vec::new();
    for number in 0.. {
        bytes.clear();
        file.take(MOST_LINE).read_until(b'\n', &mut bytes).map_err(|e| format!("cannot be read: {e}"))?;
        if bytes.is_empty() {
            break;
        }
        if bytes.len() as u64 == MOST_LINE {
            return Err(format!("cannot be read as OBJ: line {} has more than {MOST_LINE} bytes", number + 1));
        }
        let line = String::from_utf8_lossy(&bytes);
        offset = offset.or(line.strip_prefix('#').and_then(offset_of));
        let mut words = line.split('#').next().unwrap_or_default().split_whitespace();
        let fail = |what: String| format!("cannot be read as OBJ: line {}, `{}`: {what}", number + 1, line.trim());
        match words.next() {
            Some("v") => {
                let place: Vec<f64> = words.map_while(|word| word.parse().ok()).take(3).collect();
                let place = place.try_into().map_err(|_| fail("a vertex has three numbers".into()))?;
                vertices.push(place);
            }
            Some("f") => {
                let count = vertices.len();
                let corners: Option<Vec<u32>> = words.map(|word| obj_index(word, count)).collect();
                let corners = corners.filter(|corners| corners.len() >= 3).ok_or_else(|| {
                    fail(format!(
                        "a face must name three or more of the {count} vertices before it, from 1 or back from -1"
                    ))
                })?;
                triangles.extend(fan(&corners));
            }
            _ => {}
        }
    }
    Ok(placed(&vertices, triangles, offset))
}

/// Returns the vertex, from 0, that the first number of `1/2/3` names among `count`.
fn obj_index(word: &str, count: usize) -> Option<u32> {
    let named: i64 = word.split('/').next()?.parse().ok()?;
    let index = if named < 0 { count as i64 + named } else { named - 1 };
    (0..count as i64).contains(&index).then_some(index as u32)
}

/// Returns a polygon's triangles, all from its first corner.
fn fan(corners: &[u32]) -> impl Iterator<Item = [u32; 3]> {
    corners.windows(2).skip(1).map(|pair| [corners[0], pair[0], pair[1]])
}

#[cfg(test)]
mod tests {
    use super::*;

    fn square() -> Mesh {
        Mesh {
            vertices: vec![[0.0, 0.0, 0.5], [1.0, 0.0, 0.5], [1.0, 1.0, 0.5], [0.0, 1.0, 0.5]],
            normals: vec![[0.0, 0.0, 1.0]; 4],
            colours: vec![[1, 2, 255]; 4],
            triangles: vec![[0, 1, 2], [0, 2, 3]],
            origin: [0.0; 3],
        }
    }

    fn read(name: &str, bytes: &[u8]) -> Result<Mesh> {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join(name);
        std::fs::write(&path, bytes).unwrap();
        read_mesh(&path)
    }

    fn bare(mesh: Mesh) -> Mesh {
        Mesh { normals: Vec::new(), colours: Vec::new(), ..mesh }
    }

    #[test]
    fn what_is_written_reads_back() {
        for mesh in [square(), bare(square())] {
            let (mut ply, mut obj) = (Vec::new(), Vec::new());
            write_ply(&mesh, "a test", &mut ply).unwrap();
            write_obj(&mesh, "a test", &mut obj).unwrap();
            assert_eq!(read("a.ply", &ply).unwrap(), bare(square()));
            assert_eq!(read("a.OBJ", &obj).unwrap(), bare(square()));
        }
    }

    /// In single precision, coordinates of 5,000,000 have steps of 0.5.
    #[test]
    fn meshes_far_from_0_keep_their_shape() {
        let far = |point: [f32; 3]| {
            [500_000.0, 5_000_000.0, 12.0].map(|v: f64| v).into_iter().zip(point).map(|(a, b)| a + f64::from(b))
        };
        let points: Vec<[f64; 3]> = square()
            .vertices
            .iter()
            .map(|v| far(v.map(|v| 0.37 * v)).collect::<Vec<_>>().try_into().unwrap())
            .collect();
        let (vertices, origin) = with_origin(&points);
        assert_eq!(origin, [500_000.0, 5_000_000.0, 0.0]);
        let mesh = Mesh { vertices, origin, ..bare(square()) };
        let (mut ply, mut obj) = (Vec::new(), Vec::new());
        write_ply(&mesh, "a test", &mut ply).unwrap();
        write_obj(&mesh, "a test", &mut obj).unwrap();
        // Another program's, with all digits.
        let lines = points.iter().map(|[x, y, z]| format!("v {x} {y} {z}\n")).collect::<String>();
        for (name, bytes) in [("a.ply", ply), ("a.obj", obj), ("b.obj", (lines + "f 1 2 3\nf 1 3 4\n").into_bytes())] {
            let back = read(name, &bytes).unwrap();
            assert_eq!(back.origin, origin, "{name}");
            assert!((back.area() - 0.37 * 0.37).abs() < 1e-6, "{name}: {}", back.area());
            let place = |i: usize| add(back.vertex(i as u32), back.origin);
            assert!((0..4).all(|i| (0..3).all(|axis| (place(i)[axis] - points[i][axis]).abs() < 1e-5)), "{name}");
        }
        assert_eq!(with_origin(&[[9.0, -3.0, 0.0], [10.0, 0.0, 0.0]]).1, [0.0; 3]);
    }

    #[test]
    fn other_programs_ply_is_read() {
        let header = |format: &str| {
            format!(
                "ply\nformat {format} 1.0\ncomment c\nelement vertex 4\nproperty double x\nproperty double y\nproperty double z\n\
                 property uchar alpha\nelement face 1\nproperty uchar flags\nproperty list uchar uint vertex_index\n\
                 element edge 1\nproperty int a\nend_header\n"
            )
        };
        let ascii = header("ascii") + "0 0 0.5 7\n1 0 0.5 7\n1 1 0.5 7\n0 1 0.5 7\n3 4 0 1 2 3\n9\n";
        assert_eq!(read("a.ply", ascii.as_bytes()).unwrap(), bare(square()));
        let mut big = header("binary_big_endian").into_bytes();
        for vertex in square().vertices {
            vertex.iter().for_each(|v| big.extend(f64::from(*v).to_be_bytes()));
            big.push(7);
        }
        big.extend([3, 4]);
        (0..4u32).for_each(|i| big.extend(i.to_be_bytes()));
        big.extend(9i32.to_be_bytes());
        assert_eq!(read("a.ply", &big).unwrap(), bare(square()));
        assert_eq!(read("a.ply", ascii.trim_end().as_bytes()).unwrap(), bare(square()), "no end of the last line");
    }

    #[test]
    fn other_programs_obj_is_read() {
        let text = "# \u{e9}\r\nmtllib a.mtl\r\nv 0 0 0.5 1 0 0\r\nv 1 0 0.5\r\nv 1 1 0.5\r\nv 0 1 0.5\r\nvt 0.5\r\no part\r\n\
                    l 1 2 3\r\nusemtl b\r\nf 1/1/1 2//2 -2 4 # a square\r\n";
        assert_eq!(read("a.obj", text.as_bytes()).unwrap(), bare(square()));
    }

    #[test]
    fn broken_files_are_named_with_what_is_wrong() {
        let ply = |vertices: &str, faces: &str| {
            let count = (vertices.lines().count(), faces.lines().count());
            format!(
                "ply\nformat ascii 1.0\nelement vertex {}\nproperty float x\nproperty float y\nproperty float z\n\
                 element face {}\nproperty list uchar int vertex_indices\nend_header\n{vertices}{faces}",
                count.0, count.1
            )
        };
        let points = "0 0 0\n1 0 0\n0 1 0\n";
        for (name, text, word) in [
            ("a.ply", ply(points, ""), "no faces"),
            ("a.ply", ply(points, "3 0 1 3\n"), "[0, 1, 3]"),
            ("a.ply", ply(points, "3 0 1 -1\n"), "[0, 1, -1]"),
            ("a.ply", ply("0 0 0\n1 0 nan\n0 1 0\n", "3 0 1 2\n"), "vertex 1"),
            ("a.ply", ply(points, "3 0 1 2\n").replace("element vertex 3", "element vertex 5"), "PLY"),
            ("a.ply", ply(points, "3 0 1 2\n").replace("element vertex 3", "element vertex 99999999999999999"), "PLY"),
            ("a.ply", "obj".into(), "PLY"),
            ("a.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n".into(), "line 4"),
            ("a.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 0\n".into(), "3 vertices"),
            ("a.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2\n".into(), "three or more"),
            ("a.obj", "v 0 0 0\nv 1 x 0\n".into(), "line 2"),
            ("a.obj", "v 0 0 0\nv 1 0 0\n".into(), "no faces"),
            ("a.obj", "v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n".into(), "no area"),
            ("a.stl", "solid".into(), ".ply or .obj"),
        ] {
            let message = read(name, text.as_bytes()).unwrap_err().to_string();
            assert!(message.contains(word) && message.contains(name), "{word}: {message}");
        }
        assert!(read_mesh(Path::new("/nowhere/a.ply")).unwrap_err().to_string().contains("/nowhere/a.ply"));
    }
}
