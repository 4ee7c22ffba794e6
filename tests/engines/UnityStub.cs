// A stub of the part of UnityEngine that examples/unity uses, and a program that runs the component without
// Unity. The transforms of the stub have no scale and no rotation. The program calls Start, LateUpdate and
// OnDisable in the order of Unity's documentation.

using System;
using System.Collections.Generic;
using System.Linq;
using System.Reflection;

namespace UnityEngine
{
    public struct Vector3
    {
        public float x, y, z;
        public Vector3(float x, float y, float z) { this.x = x; this.y = y; this.z = z; }
        public static Vector3 Scale(Vector3 a, Vector3 b) { return new Vector3(a.x * b.x, a.y * b.y, a.z * b.z); }
    }

    [AttributeUsage(AttributeTargets.Field)]
    public sealed class TooltipAttribute : Attribute
    {
        public TooltipAttribute(string text) { }
    }

    public class Object
    {
        public string name = "";
    }

    public class Component : Object
    {
        public Transform transform;
        public Renderer[] below = new Renderer[0];
        public T[] GetComponentsInChildren<T>(bool includeInactive) { return below.Cast<T>().ToArray(); }
    }

    public sealed class Transform : Component
    {
        public Vector3 position;
        public Vector3 InverseTransformPoint(Vector3 p)
        {
            return new Vector3(p.x - position.x, p.y - position.y, p.z - position.z);
        }
    }

    public class Behaviour : Component
    {
        public bool enabled = true;
    }

    public class MonoBehaviour : Behaviour { }

    public class Renderer : Component
    {
        public bool forceRenderingOff;
    }

    public sealed class Camera : Behaviour
    {
        public static Camera main = null;
    }

    public static class Application
    {
        public static string streamingAssetsPath = ".";
    }

    public static class Debug
    {
        public static List<string> said = new List<string>();
        public static void LogError(object message, Object context) { said.Add("error: " + message); }
        public static void LogWarning(object message, Object context) { said.Add("warning: " + message); }
    }
}

// Runs the component in a level with a renderer for each name of names.txt. For each line "x y z" of
// eyes.txt, a point in the space of the file, prints the cell and the names of the shown renderers.
static class UnityStubProgram
{
    static void Call(object of, string message)
    {
        MethodInfo method = of.GetType().GetMethod(message, BindingFlags.Instance | BindingFlags.NonPublic);
        if (method == null) throw new Exception("the component has no method " + message);
        method.Invoke(of, null);
    }

    static void Main(string[] arguments)
    {
        var level = new UnityEngine.Transform { position = new UnityEngine.Vector3(10f, 20f, 30f) };
        var names = System.IO.File.ReadAllLines("names.txt");
        var all = names.Select(name => new UnityEngine.Renderer { name = name }).ToArray();
        var eye = new UnityEngine.Camera { transform = new UnityEngine.Transform() };
        var culler = new SightlineCuller { file = arguments[0], transform = level, below = all, name = "level" };
        UnityEngine.Camera.main = eye;
        Call(culler, "Start");
        if (culler.enabled)
        {
            foreach (string line in System.IO.File.ReadAllLines("eyes.txt"))
            {
                float[] at = line.Split(' ').Select(float.Parse).ToArray();
                // The x axis of Unity's space has the opposite direction.
                eye.transform.position = new UnityEngine.Vector3(10f - at[0], 20f + at[1], 30f + at[2]);
                Call(culler, "LateUpdate");
                var shown = all.Where(renderer => !renderer.forceRenderingOff).Select(renderer => renderer.name);
                Console.WriteLine(culler.Cell + ":" + string.Join(",", shown));
            }
            Call(culler, "OnDisable");
            Console.WriteLine("off:" + all.Count(renderer => renderer.forceRenderingOff));
        }
        foreach (string text in UnityEngine.Debug.said) Console.WriteLine(text);
        Call(culler, "OnDestroy");
    }
}
