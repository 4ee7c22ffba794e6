// Traces packets of 16 rays that the host uploads (tracer.rs). Needs traverse.wgsl.

// For each packet: origins by axis and lane, then directions by axis and lane.
@group(1) @binding(0) var<storage, read> rays: array<f32>;
// For each packet: distances by lane, then ids by lane.
@group(1) @binding(1) var<storage, read_write> hits: array<u32>;

@compute @workgroup_size(64)
fn trace(@builtin(global_invocation_id) id: vec3<u32>) {
    let packet = id.x / 16u;
    let lane = id.x % 16u;
    let source = packet * 96u + lane;
    let out = packet * 32u + lane;
    let origin = vec3<f32>(rays[source], rays[source + 16u], rays[source + 32u]);
    let direction = vec3<f32>(rays[source + 48u], rays[source + 64u], rays[source + 80u]);
    let hit = nearest_along(origin, direction);
    hits[out] = select(bitcast<u32>(hit.distance), INFINITE, hit.id == SKY);
    hits[out + 16u] = hit.id;
}
