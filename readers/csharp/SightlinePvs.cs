// Reads .pvs results in .NET and Unity: view cells, and what is visible from each. Calls the C library
// (readers/c), which must be where the loader finds it: libsightline_pvs_c.so, .dylib or sightline_pvs_c.dll.
//
//   using (var pvs = new Sightline.Pvs("level.pvs")) {
//       long cell = pvs.CellOf(1f, 2f, 3f);                 // -1 outside the view box
//       if (cell >= 0) foreach (uint id in pvs.Visible((uint)cell)) Draw(id);
//   }
//
// Queries may come from several threads at a time.

using System;
using System.Runtime.InteropServices;
using System.Text;

namespace Sightline
{
    /// <summary>Why a result is refused.</summary>
    public sealed class PvsException : Exception
    {
        public PvsException(string message) : base(message) { }
    }

    /// <summary>An object of the scene: its name and its triangles.</summary>
    public struct PvsObject
    {
        public string Name;
        public uint First, Count;
    }

    /// <summary>An opened result.</summary>
    public sealed class Pvs : IDisposable
    {
        const string Library = "sightline_pvs_c";
        IntPtr handle;

        /// <summary>Opens a file and checks all of it.</summary>
        public Pvs(string path)
        {
            IntPtr error;
            handle = sightline_pvs_open(Encoding.UTF8.GetBytes(path + "\0"), out error);
            Check(error);
        }

        /// <summary>Reads a result from memory and checks all of it.</summary>
        public Pvs(byte[] bytes)
        {
            IntPtr error;
            handle = sightline_pvs_read(bytes, (UIntPtr)bytes.Length, out error);
            Check(error);
        }

        void Check(IntPtr error)
        {
            if (handle != IntPtr.Zero) return;
            string why = Text(error);
            sightline_pvs_free(error);
            throw new PvsException(why);
        }

        IntPtr Open
        {
            get
            {
                if (handle == IntPtr.Zero) throw new ObjectDisposedException("Sightline.Pvs");
                return handle;
            }
        }

        public uint Triangles { get { return sightline_pvs_triangles(Open); } }
        public uint Cells { get { return sightline_pvs_cells(Open); } }
        public uint Objects { get { return sightline_pvs_objects(Open); } }

        /// <summary>How the sets were made: aggressive, exact, verified or portals.</summary>
        public string Method { get { return Text(sightline_pvs_method(Open)); } }

        /// <summary>The description of the bake, as JSON.</summary>
        public string Info { get { return Text(sightline_pvs_info(Open)); } }

        public PvsObject Object(uint number)
        {
            uint first, count;
            IntPtr name = sightline_pvs_object(Open, number, out first, out count);
            if (name == IntPtr.Zero) throw new ArgumentOutOfRangeException("number");
            return new PvsObject { Name = Text(name), First = first, Count = count };
        }

        /// <summary>The cell that holds a point in the scene's space; -1 outside the view box.</summary>
        public long CellOf(float x, float y, float z) { return sightline_pvs_cell_of(Open, x, y, z); }

        /// <summary>The box of a cell: least x, y, z, then greatest x, y, z.</summary>
        public float[] Box(uint cell)
        {
            var box = new float[6];
            if (!sightline_pvs_cell_box(Open, cell, box)) throw new ArgumentOutOfRangeException("cell");
            return box;
        }

        /// <summary>Whether viewpoints are in a cell.</summary>
        public bool IsReached(uint cell) { return (Flags(cell) & 2) == 0; }

        long Flags(uint cell)
        {
            long flags = sightline_pvs_flags(Open, cell);
            if (flags < 0) throw new ArgumentOutOfRangeException("cell");
            return flags;
        }

        /// <summary>The triangles to draw from a cell, ascending.</summary>
        public uint[] Visible(uint cell) { return Set(0, cell); }

        /// <summary>Those of them that were neither seen nor proved hidden.</summary>
        public uint[] Undecided(uint cell) { return Set(1, cell); }

        /// <summary>The objects of the triangles to draw from a cell, ascending.</summary>
        public uint[] VisibleObjects(uint cell) { return Set(2, cell); }

        /// <summary>The objects of the undecided triangles.</summary>
        public uint[] UndecidedObjects(uint cell) { return Set(3, cell); }

        uint[] Set(uint set, uint cell)
        {
            Flags(cell);
            long count = sightline_pvs_set(Open, set, cell, null, UIntPtr.Zero);
            if (count < 0) throw new PvsException("the .pvs file was changed since it was opened");
            var ids = new uint[count];
            if (count > 0) sightline_pvs_set(Open, set, cell, ids, (UIntPtr)ids.Length);
            return ids;
        }

        public void Dispose()
        {
            sightline_pvs_close(handle);
            handle = IntPtr.Zero;
            GC.SuppressFinalize(this);
        }

        ~Pvs() { sightline_pvs_close(handle); }

        // The strings of the library are in UTF-8, which .NET Framework and Mono do not marshal by themselves.
        static string Text(IntPtr at)
        {
            int length = 0;
            while (Marshal.ReadByte(at, length) != 0) length++;
            var bytes = new byte[length];
            Marshal.Copy(at, bytes, 0, length);
            return Encoding.UTF8.GetString(bytes);
        }

        [DllImport(Library)] static extern IntPtr sightline_pvs_open(byte[] path, out IntPtr error);
        [DllImport(Library)] static extern IntPtr sightline_pvs_read(byte[] bytes, UIntPtr length, out IntPtr error);
        [DllImport(Library)] static extern void sightline_pvs_close(IntPtr pvs);
        [DllImport(Library)] static extern void sightline_pvs_free(IntPtr error);
        [DllImport(Library)] static extern uint sightline_pvs_triangles(IntPtr pvs);
        [DllImport(Library)] static extern uint sightline_pvs_cells(IntPtr pvs);
        [DllImport(Library)] static extern uint sightline_pvs_objects(IntPtr pvs);
        [DllImport(Library)] static extern IntPtr sightline_pvs_method(IntPtr pvs);
        [DllImport(Library)] static extern IntPtr sightline_pvs_info(IntPtr pvs);
        [DllImport(Library)]
        static extern IntPtr sightline_pvs_object(IntPtr pvs, uint number, out uint first, out uint count);
        [DllImport(Library)] static extern long sightline_pvs_cell_of(IntPtr pvs, float x, float y, float z);
        [DllImport(Library)]
        [return: MarshalAs(UnmanagedType.I1)]
        static extern bool sightline_pvs_cell_box(IntPtr pvs, uint cell, float[] box);
        [DllImport(Library)] static extern long sightline_pvs_flags(IntPtr pvs, uint cell);
        [DllImport(Library)]
        static extern long sightline_pvs_set(IntPtr pvs, uint set, uint cell, [Out] uint[] ids, UIntPtr room);
    }
}
