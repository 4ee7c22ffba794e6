// A reader of .pvs results for .NET and Unity: view cells and their visible sets. The reader calls the C
// library (readers/c). Install libsightline_pvs_c.so, .dylib or sightline_pvs_c.dll in a folder that the
// loader searches.
//
//   using (var pvs = new Sightline.Pvs("level.pvs")) {
//       long cell = pvs.CellOf(1f, 2f, 3f);                 // -1 outside the view box
//       if (cell >= 0) foreach (uint id in pvs.Visible((uint)cell)) Draw(id);
//   }
// Several threads may query a result at the same time.

using System;
using System.Runtime.InteropServices;
using System.Text;

namespace Sightline
{
    /// <summary>The error of a result that the reader rejects.</summary>
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

    // A handle that keeps a result open while a query runs, and closes the result once.
    sealed class PvsHandle : SafeHandle
    {
        public PvsHandle(IntPtr opened) : base(IntPtr.Zero, true) { SetHandle(opened); }
        public override bool IsInvalid { get { return handle == IntPtr.Zero; } }

        protected override bool ReleaseHandle()
        {
            Pvs.sightline_pvs_close(handle);
            return true;
        }
    }

    /// <summary>An opened result.</summary>
    public sealed class Pvs : IDisposable
    {
        const string Library = "sightline_pvs_c";
        const CallingConvention C = CallingConvention.Cdecl;
        readonly PvsHandle handle;

        /// <summary>Opens a file and checks all of it.</summary>
        public Pvs(string path)
        {
            IntPtr error;
            handle = new PvsHandle(sightline_pvs_open(Encoding.UTF8.GetBytes(path + "\0"), out error));
            Check(error);
        }

        /// <summary>Reads a result from memory and checks all of it.</summary>
        public Pvs(byte[] bytes)
        {
            IntPtr error;
            handle = new PvsHandle(sightline_pvs_read(bytes, (UIntPtr)bytes.Length, out error));
            Check(error);
        }

        void Check(IntPtr error)
        {
            if (!handle.IsInvalid) return;
            string why = Text(error);
            sightline_pvs_free(error);
            throw new PvsException(why);
        }

        public uint Triangles { get { return sightline_pvs_triangles(handle); } }
        public uint Cells { get { return sightline_pvs_cells(handle); } }
        public uint Objects { get { return sightline_pvs_objects(handle); } }

        /// <summary>The method of the bake: aggressive, exact, verified or portals.</summary>
        public string Method { get { return Alive(Text(sightline_pvs_method(handle))); } }

        /// <summary>The description of the bake, as JSON.</summary>
        public string Info { get { return Alive(Text(sightline_pvs_info(handle))); } }

        public PvsObject Object(uint number)
        {
            uint first, count;
            IntPtr name = sightline_pvs_object(handle, number, out first, out count);
            if (name == IntPtr.Zero) throw new ArgumentOutOfRangeException("number");
            return new PvsObject { Name = Alive(Text(name)), First = first, Count = count };
        }

        /// <summary>Returns the cell of a point in world space, or -1 outside the view box.</summary>
        public long CellOf(float x, float y, float z) { return sightline_pvs_cell_of(handle, x, y, z); }

        /// <summary>Returns the box of a cell: minimum x, y, z, then maximum x, y, z.</summary>
        public float[] Box(uint cell)
        {
            var box = new float[6];
            if (!sightline_pvs_cell_box(handle, cell, box)) throw new ArgumentOutOfRangeException("cell");
            return box;
        }

        /// <summary>Returns true if the cell contains viewpoints.</summary>
        public bool IsReached(uint cell) { return (Flags(cell) & 2) == 0; }

        long Flags(uint cell)
        {
            long flags = sightline_pvs_flags(handle, cell);
            if (flags < 0) throw new ArgumentOutOfRangeException("cell");
            return flags;
        }

        /// <summary>Returns the triangles to draw from a cell, ascending.</summary>
        public uint[] Visible(uint cell) { return Set(0, cell); }

        /// <summary>Returns the triangles to draw that were neither seen nor proved hidden.</summary>
        public uint[] Undecided(uint cell) { return Set(1, cell); }

        /// <summary>Returns the objects of the triangles to draw from a cell, ascending.</summary>
        public uint[] VisibleObjects(uint cell) { return Set(2, cell); }

        /// <summary>Returns the objects with undecided triangles and without a visible triangle.</summary>
        public uint[] UndecidedObjects(uint cell) { return Set(3, cell); }

        uint[] Set(uint set, uint cell)
        {
            Flags(cell);
            long count = sightline_pvs_set(handle, set, cell, null, UIntPtr.Zero);
            if (count < 0)
            {
                throw new PvsException("the .pvs file was changed while it was open; open the file again");
            }
            var ids = new uint[count];
            if (count > 0) sightline_pvs_set(handle, set, cell, ids, (UIntPtr)ids.Length);
            return ids;
        }

        public void Dispose() { handle.Dispose(); }

        // The library's strings are valid while the result is open, so the result must stay open until they are copied.
        string Alive(string copied)
        {
            GC.KeepAlive(handle);
            return copied;
        }

        // The strings of the library are in UTF-8, which Mono and .NET Framework do not marshal.
        static string Text(IntPtr at)
        {
            int length = 0;
            while (Marshal.ReadByte(at, length) != 0) length++;
            var bytes = new byte[length];
            Marshal.Copy(at, bytes, 0, length);
            return Encoding.UTF8.GetString(bytes);
        }

        [DllImport(Library, CallingConvention = C)] static extern IntPtr sightline_pvs_open(byte[] path, out IntPtr error);
        [DllImport(Library, CallingConvention = C)] static extern IntPtr sightline_pvs_read(byte[] bytes, UIntPtr length, out IntPtr error);
        [DllImport(Library, CallingConvention = C)] internal static extern void sightline_pvs_close(IntPtr pvs);
        [DllImport(Library, CallingConvention = C)] static extern void sightline_pvs_free(IntPtr error);
        [DllImport(Library, CallingConvention = C)] static extern uint sightline_pvs_triangles(PvsHandle pvs);
        [DllImport(Library, CallingConvention = C)] static extern uint sightline_pvs_cells(PvsHandle pvs);
        [DllImport(Library, CallingConvention = C)] static extern uint sightline_pvs_objects(PvsHandle pvs);
        [DllImport(Library, CallingConvention = C)] static extern IntPtr sightline_pvs_method(PvsHandle pvs);
        [DllImport(Library, CallingConvention = C)] static extern IntPtr sightline_pvs_info(PvsHandle pvs);
        [DllImport(Library, CallingConvention = C)]
        static extern IntPtr sightline_pvs_object(PvsHandle pvs, uint number, out uint first, out uint count);
        [DllImport(Library, CallingConvention = C)] static extern long sightline_pvs_cell_of(PvsHandle pvs, float x, float y, float z);
        [DllImport(Library, CallingConvention = C)]
        [return: MarshalAs(UnmanagedType.I1)]
        static extern bool sightline_pvs_cell_box(PvsHandle pvs, uint cell, float[] box);
        [DllImport(Library, CallingConvention = C)] static extern long sightline_pvs_flags(PvsHandle pvs, uint cell);
        [DllImport(Library, CallingConvention = C)]
        static extern long sightline_pvs_set(PvsHandle pvs, uint set, uint cell, [Out] uint[] ids, UIntPtr room);
    }
}
