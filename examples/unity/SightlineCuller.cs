// Hides the renderers of a level that are not visible from the cell of the camera.
//
// Copy this file, readers/csharp/SightlinePvs.cs and the C library (readers/c, to Assets/Plugins) into the project and
// the .pvs file to Assets/StreamingAssets. Add the component to the level's root, the object that the glTF importer
// made. Renderers are matched with the result's objects by the names of their glTF nodes; renderers of one name are
// shown and hidden together. Those whose node is in no set at all, or not in the file, are left as they are.

using System.Collections.Generic;
using System.IO;
using Sightline;
using UnityEngine;

/// <summary>Hides what the camera's cell does not see.</summary>
public sealed class SightlineCuller : MonoBehaviour
{
    [Tooltip("The result, in StreamingAssets.")]
    public string file = "level.pvs";

    [Tooltip("The eye; without one, the main camera.")]
    public Camera viewer;

    [Tooltip("From this object's space to the file's. Importers mirror an axis: glTFast and UnityGLTF x.")]
    public Vector3 axes = new Vector3(-1f, 1f, 1f);

    const long Unknown = -1, None = -2;

    Pvs pvs;
    long cell = None;
    uint[] nodeOf;                        // the node's number in `renderers`, for each object
    List<Renderer>[] renderers;           // of each node
    bool[] known, seen;                   // of each node: in some set, in this cell's set

    /// <summary>The cell of the last update; negative where nothing is known and everything is drawn.</summary>
    public long Cell { get { return cell; } }

    void Start()
    {
        try
        {
            pvs = new Pvs(Path.Combine(Application.streamingAssetsPath, file));
        }
        catch (PvsException e)
        {
            Debug.LogError(file + ": " + e.Message + "; nothing is culled", this);
            enabled = false;
            return;
        }
        Match(GetComponentsInChildren<Renderer>(true));
    }

    // An object is named "node/mesh#primitive".
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
            Debug.LogWarning(file + ": no renderer below " + name + " has the name of a node that was baked", this);
        }
        known = new bool[numbers.Count];
        seen = new bool[numbers.Count];
        for (uint k = 0; k < pvs.Cells; k++)
        {
            foreach (uint thing in pvs.VisibleObjects(k)) known[nodeOf[thing]] = true;
        }
    }

    // After the camera has moved.
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
            // Not `enabled`, which is the game's own.
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
