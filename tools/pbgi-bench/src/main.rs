//! Model error against converged references (temporary driver).
use pbgi_build::*;
use pbgi_cloud::*;
use pbgi_light::*;
use pbgi_math::*;
use pbgi_scene::*;
use pbgi_schedule::*;
use pbgi_store::*;
use std::path::Path;

struct Stream(Vec<(MortonCode, Surfel)>, usize);
impl SortedStream for Stream {
    fn read_chunk(&mut self, out: &mut Vec<(MortonCode, Surfel)>) -> Result<bool, StreamError> {
        let end = (self.1 + 4096).min(self.0.len());
        out.extend_from_slice(&self.0[self.1..end]);
        self.1 = end;
        Ok(end < self.0.len())
    }
}

fn build(surfels: &[Surfel], path: &Path) -> Octree {
    let root = RootCube::from_bounds(&Aabb::from_points(surfels.iter().map(Surfel::center)));
    let mut coded: Vec<_> = surfels.iter().map(|s| (root.code(s.center()), *s)).collect();
    coded.sort_by_key(|s| s.0);
    let f = |g: &dyn Fn(&Surfel) -> f32| surfels.iter().map(|s| g(s)).fold(0.0f32, f32::max);
    let summary = StreamSummary {
        root, origin: DVec3::ZERO, surfel_count: surfels.len() as u64,
        radius_max: f(&|s| s.radius), area_max: f(&|s| s.area),
        radiance_max: f(&|s| s.radiance[0].max(s.radiance[1]).max(s.radiance[2])),
        any_albedo: true, any_isotropic: false, z_up: false,
    };
    let t = std::time::Instant::now();
    let leaf: usize = std::env::var("LEAF").ok().and_then(|v| v.parse().ok()).unwrap_or(16);
    let report = build_octree(&mut Stream(coded, 0), &summary, &BuildOptions { leaf_surfels_max: leaf, ..BuildOptions::default() }, path).unwrap();
    println!("build {:.2} M/s, {:.1} B/surfel (surfels {:.1} hot {:.1} lobes {:.1} rest {:.1}), {} nodes, {} pages", report.surfels as f64 / t.elapsed().as_secs_f64() / 1e6,
        report.file_bytes as f64 / report.surfels as f64, report.surfel_bytes as f64 / report.surfels as f64, report.node_hot_bytes as f64 / report.surfels as f64, report.lobe_bytes as f64 / report.surfels as f64, report.overhead_bytes as f64 / report.surfels as f64, report.nodes, report.pages);
    Octree::open(path, &OpenOptions { cache_bytes: 2 << 30, readers: 2, backend: Backend::Map }).unwrap()
}

fn main() {
    let args: Vec<String> = std::env::args().collect();
    let env = |k: &str, d: f32| std::env::var(k).ok().and_then(|v| v.parse().ok()).unwrap_or(d);
    let dir = Path::new("../shared/reference");
    let n = env("N", 1e6) as u64;
    let settings = GatherSettings { solid_angle_sr: env("SR", 0.03), raster_edge: env("R", 8.0) as usize, near_radii: env("NEAR", 5.0), bias: env("BIAS", 0.1), ..GatherSettings::default() };
    let every = env("EVERY", 4.0) as usize;
    let tmp = std::env::temp_dir().join("pbgi-bench-tmp.pbgi");
    for name in &args[1..] {
        let scene = read_scene(&dir.join(format!("{name}.glb"))).unwrap();
        let mut source = DicedScene::new(&scene, DiceOptions { spacing: Spacing::Count(n), two_sided: TwoSided::Material }).unwrap();
        let mut surfels = Vec::new();
        while source.read_chunk(&mut surfels).unwrap() {}
        if std::env::var("ONLY").is_ok() { surfels.retain(|s| s.radiance[0] > 0.0); println!("{:?} {:?}", surfels[0], surfels[0].normal()); }
        println!("== {name}: {} surfels, spacing {:.4}", surfels.len(), source.spacing());
        let table = ReceiverTable::read(&dir.join(format!("{name}_receivers.ply"))).unwrap();
        let receivers: Vec<Receiver> = table.positions.iter().zip(&table.normals).map(|(p, n)| Receiver { position: *p, normal: *n }).step_by(every).collect();
        let column = |c: &str| -> Vec<f32> { table.column(c).unwrap().iter().copied().step_by(every).collect() };
        let rgb = |prefix: &str| -> Vec<f32> { let v = ["r", "g", "b"].map(|c| column(&format!("{prefix}_{c}"))); (0..receivers.len()).flat_map(|i| [v[0][i], v[1][i], v[2][i]]).collect() };
        let octree = build(&surfels, &tmp);
        let run = |octree: &Octree, light: Option<&PreparedLight>, settings: &GatherSettings| {
            let (s, r) = shade_receivers(octree, light, &receivers, &ShadeOptions { gather: *settings, threads: 1, ..ShadeOptions::default() }).unwrap();
            (s, r)
        };
        let report = |what: &str, result: &[f32], reference: &[f32], r: &ShadeReport| {
            let m = pbgi_image::compare(result, reference).unwrap();
            println!("{what:28} rRMSE {:6.2}%  bias {:+6.2}%  p50 {:5.2}% p99 {:6.1}%  {:7.1} us/receiver  cut {:6.0} visited {:6.0} opaque {:5.0}", m.rrmse * 100.0, m.bias * 100.0, m.p50 * 100.0, m.p99 * 100.0, r.seconds * 1e6 / r.receivers as f64, r.cut.cut_size() as f64 / r.receivers as f64, r.cut.nodes_visited as f64 / r.receivers as f64, r.cut.culled_opaque as f64 / r.receivers as f64);
        };
        let flat = |s: &[Shading], f: &dyn Fn(&Shading) -> [f32; 3]| -> Vec<f32> { s.iter().flat_map(f).collect() };
        match name.as_str() {
            "room" => {
                let (s, r) = run(&octree, None, &settings);
                for i in (0..receivers.len()).step_by(receivers.len()/6) { println!("{} {} E {:?} ref {:?}", receivers[i].position, receivers[i].normal, s[i].irradiance(), rgb("ref_direct")[3*i]); }
                report("direct", &flat(&s, &|s| s.irradiance()), &rgb("ref_direct"), &r);
                // light the surfels, drop the emitter
                let all: Vec<Receiver> = surfels.iter().map(|s| Receiver { position: s.center(), normal: s.normal() }).collect();
                let (lit, r2) = shade_receivers(&octree, None, &all, &ShadeOptions { gather: GatherSettings { solid_angle_sr: 0.1, ..settings }, threads: 2, ..ShadeOptions::default() }).unwrap();
                println!("relight {:.1} us/surfel", r2.seconds * 1e6 / r2.receivers as f64);
                let relit: Vec<Surfel> = surfels.iter().zip(&lit).map(|(s, l)| { let e = l.irradiance(); let a = s.albedo_rgb(); let black = s.radiance[0] > 0.0; s.with_radiance(std::array::from_fn(|c| if black { 0.0 } else { a[c] / std::f32::consts::PI * e[c] })) }).collect();
                let octree = build(&relit, &tmp);
                let (s, r) = run(&octree, None, &settings);
                report("indirect", &flat(&s, &|s| s.irradiance()), &rgb("ref_indirect"), &r);
            }
            "plaza" => for (file, col) in [("plaza_sky", "ref_sky"), ("plaza_sky_sun", "ref_sky_sun")] {
                let image = pbgi_image::read_environment(&dir.join(format!("{file}.exr"))).unwrap();
                let environment = Environment::from_image(image, EnvironmentOptions::default()).unwrap();
                let light = PreparedLight::new(&environment, settings.raster_edge);
                let (s, r) = run(&octree, Some(&light), &settings);
                report(col, &flat(&s, &|s| s.environment_irradiance), &rgb(col), &r);
            },
            "embers" => {
                let (s, r) = run(&octree, None, &settings);
                report("irradiance", &flat(&s, &|s| s.irradiance()), &rgb("ref_irradiance"), &r);
            }
            _ => {
                let (s, r) = run(&octree, None, &settings);
                let ao: Vec<f32> = s.iter().map(|s| s.ambient_occlusion).collect();
                report("ao", &ao, &column("ref_ao"), &r);
            }
        }
    }
}
