;;;; guide.lisp: what CONTRIBUTING.md shows, and versions.  For rtest_guide.mac.
;;;;
;;;;   versions_told()             those of anmech_version, of the manual and of CHANGES.md
;;;;   write_example(name, file)   writes what stands in CONTRIBUTING.md between ```maxima NAME and ```

(in-package :anmech-tests)

(defun text-of-file (name)
  (with-open-file (stream (concatenate 'string *root* name))
    (format nil "~{~a~%~}" (loop for line = (read-line stream nil) while line collect line))))

(defun between (start end text)
  "What stands in TEXT between the first START and the END after it."
  (let ((from (search start text)))
    (and from
         (subseq text (+ from (length start)) (search end text :start2 (+ from (length start)))))))

(in-package :maxima)

(defmfun $versions_told ()
  (flet ((told (start end file) (anmech-tests::between start end (anmech-tests::text-of-file file))))
    (list '(mlist)
          (mfuncall '$anmech_version)
          (told "@set VERSION " (string #\Newline) "share/anmech/anmech.texi")
          (told "## " " " "CHANGES.md"))))

(defmfun $write_example (name file)
  (with-open-file (stream file :direction :output :if-exists :supersede)
    (write-string (anmech-tests::between (format nil "```maxima ~a~%" name) "```"
                                         (anmech-tests::text-of-file "CONTRIBUTING.md"))
                  stream))
  '$done)
