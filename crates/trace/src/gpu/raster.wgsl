// Draws triangles into one face of the item buffer. A pixel contains the triangle's slot (its index in the
// vertex buffers) plus one, or 0 for sky.

struct Face {
    // The xyz fields of the first three vectors are the face's right, up and forward directions; right.w is
    // the distance of the near plane.
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

// The first instance of a draw call is the first slot of its vertex buffer, so slot = base + vertex / 3.
@vertex
fn corner(
    @location(0) world: vec3f,
    @builtin(vertex_index) vertex: u32,
    @builtin(instance_index) base: u32,
) -> Corner {
    let d = world - face.eye.xyz;
    // Row y of the framebuffer shows v = (2y+1)/n - 1, but y points up in clip space, so the sign changes.
    // The frustum has 90 degrees, an infinite far plane, and reversed depth near / forward.
    let position =
        vec4f(dot(d, face.right.xyz), -dot(d, face.up.xyz), face.right.w, dot(d, face.forward.xyz));
    return Corner(position, base + vertex / 3u + 1u);
}

@fragment
fn item(in: Corner) -> @location(0) u32 {
    return in.item;
}
