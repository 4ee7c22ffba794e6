// Draws triangles into one face of the item buffer. A pixel gets the triangle's slot plus one; 0 stays sky.

struct Face {
    // xyz: the face's right, up and forward vectors; right.w: distance of the near plane.
    right: vec4f,
    up: vec4f,
    forward: vec4f,
    eye: vec4f,
}

@group(0) @binding(0) var<uniform> face: Face;

struct Corner {
    @builtin(position) @invariant position: vec4f,
    @location(0) @interpolate(flat, either) item: u32,
}

// The draw's first instance carries the first slot of the vertex buffer, so that vertex numbers give slots.
@vertex
fn corner(
    @location(0) world: vec3f,
    @builtin(vertex_index) vertex: u32,
    @builtin(instance_index) base: u32,
) -> Corner {
    let d = world - face.eye.xyz;
    // Framebuffer rows run down while the pixels' v runs up with y: row y is v = (2y+1)/n - 1, hence the
    // minus. 90 degrees, infinite far plane, reversed depth near / forward.
    let position =
        vec4f(dot(d, face.right.xyz), -dot(d, face.up.xyz), face.right.w, dot(d, face.forward.xyz));
    return Corner(position, base + vertex / 3u + 1u);
}

@fragment
fn item(in: Corner) -> @location(0) u32 {
    return in.item;
}
