// Prints the sets of results as JSON, and for damaged results whether the reader rejects them:
// Say DAMAGED NAME...  reads NAME.pvs, and damaged-0.pvs to damaged-(DAMAGED-1).pvs.

using System;
using System.IO;
using System.Linq;
using Sightline;

static class Say
{
    static string Sets(Pvs pvs, Func<uint, uint[]> of)
    {
        var all = Enumerable.Range(0, (int)pvs.Cells).Select(cell => "[" + string.Join(",", of((uint)cell)) + "]");
        return "[" + string.Join(",", all) + "]";
    }

    static void Main(string[] arguments)
    {
        var said = arguments.Skip(1).Select(name =>
        {
            using (var pvs = new Pvs(name + ".pvs"))
            {
                uint last = pvs.Cells - 1;
                float[] box = pvs.Box(last);
                if (pvs.CellOf(box[3], box[4], box[5]) != last) throw new Exception("the last cell");
                return "{\"name\":\"" + name + "\",\"triangles\":" + pvs.Triangles + ",\"method\":\"" + pvs.Method
                    + "\",\"cells\":" + pvs.Cells + ",\"visible\":" + Sets(pvs, pvs.Visible)
                    + ",\"undecided\":" + Sets(pvs, pvs.Undecided) + "}";
            }
        }).ToArray();
        var refused = Enumerable.Range(0, int.Parse(arguments[0])).Select(k =>
        {
            try
            {
                new Pvs(File.ReadAllBytes("damaged-" + k + ".pvs")).Dispose();
                return "false";
            }
            catch (PvsException)
            {
                return "true";
            }
        }).ToArray();
        Console.WriteLine("{\"said\":[" + string.Join(",", said) + "],\"refused\":[" + string.Join(",", refused) + "]}");
    }
}
