// Hides the renderers of a level that are not visible from the cell of the camera.
//
// Copy this file and readers/csharp/SightlinePvs.cs into the project, the C library (readers/c) to
// Assets/Plugins, and the .pvs file to Assets/StreamingAssets. Add the component to the root object of the
// level, which the glTF importer creates. The component assigns renderers to objects of the result by the
// names of their glTF nodes. It shows or hides renderers of the same name together. It does not change
// renderers whose node is in no set or not in the result.

using System.Collections.Generic;
using System.IO;
using Sightline;
using UnityEngine;

/// <summary>A component that hides the renderers that are not visible from the cell of the camera.</summary>
public sealed class SightlineCuller : MonoBehaviour
{
    [Tooltip("The file of the result, in StreamingAssets.")]
    public string file = "level.pvs";

    [Tooltip("The camera. Default: the main camera.")]
    public Camera viewer;

    [Tooltip("The scale from this object's space to the file's space. glTFast and UnityGLTF mirror the x axis.")]
    public Vector3 axes = new Vector3(-1f, 1f, 1f);

    const long Unknown = -1, None = -2;

    Pvs pvs;
    long cell = None;
    uint[] nodeOf;                        // The number of the node of each object.
    List<Renderer>[] renderers;           // The renderers of each node.
    bool[] known, seen;                   // For each node, true if a set or the current set contains it.

    /// <summary>The cell of the last update. If the cell is negative, the component shows all
    /// renderers.</summary>
    public long Cell { get { return cell; } }

    void Start()
    {
        try
        {
            pvs = new Pvs(Path.Combine(Application.streamingAssetsPath, file));
        }
        catch (PvsException e)
        {
            Debug.LogError(file + ": " + e.Message + "; culling is off", this);
            enabled = false;
            return;
        }
        Match(GetComponentsInChildren<Renderer>(true));
    }

    // Assigns renderers to nodes by name. The name of an object is "node/mesh#primitive".
    void Match(Renderer[] all)
    {
        var numbers = new Dictionary<string, uint>();
        nodeOf = new uint[pvs.Objects];
        for (uint k = 0; k < nodeOf.Length; k++)
        {
            string node = pvs.Object(k).Name.Split('/')[0];
            if (!numbers.TryGetValue(node, out nodeOf[k])) numbers[node] = nodeOf[k] = (uint)numbers.Count;
        }
        renderers = new List<Renderer>[numbers.Count];
        for (int k = 0; k < renderers.Length; k++) renderers[k] = new List<Renderer>();
        int matched = 0;
        foreach (Renderer renderer in all)
        {
            uint node;
            if (!numbers.TryGetValue(renderer.name, out node)) continue;
            renderers[node].Add(renderer);
            matched++;
        }
        if (matched == 0)
        {
            Debug.LogWarning(file + ": no renderer below " + name + " has the name of a baked node", this);
        }
        known = new bool[numbers.Count];
        seen = new bool[numbers.Count];
        for (uint k = 0; k < pvs.Cells; k++)
        {
            foreach (uint thing in pvs.VisibleObjects(k)) known[nodeOf[thing]] = true;
        }
    }

    // Shows and hides renderers. Unity calls LateUpdate after other scripts have moved the camera.
    void LateUpdate()
    {
        Camera eye = viewer != null ? viewer : Camera.main;
        if (eye == null) return;
        Vector3 at = Vector3.Scale(transform.InverseTransformPoint(eye.transform.position), axes);
        long now = pvs.CellOf(at.x, at.y, at.z);
        if (now >= 0 && !pvs.IsReached((uint)now)) now = Unknown;
        if (now == cell) return;
        cell = now;
        for (int k = 0; k < seen.Length; k++) seen[k] = now < 0 || !known[k];
        if (now >= 0)
        {
            foreach (uint thing in pvs.VisibleObjects((uint)now)) seen[nodeOf[thing]] = true;
        }
        for (int k = 0; k < seen.Length; k++)
        {
            // The component does not use `enabled`, because the game may use it.
            foreach (Renderer renderer in renderers[k]) if (renderer != null) renderer.forceRenderingOff = !seen[k];
        }
    }

    void OnDisable()
    {
        if (renderers == null) return;
        foreach (List<Renderer> of in renderers)
        {
            foreach (Renderer renderer in of) if (renderer != null) renderer.forceRenderingOff = false;
        }
        cell = None;
    }

    void OnDestroy()
    {
        if (pvs != null) pvs.Dispose();
    }
}
